"""Bulk material of the machine that each session watches."""

import numpy as np

from server.display.job_display import JobDisplay
from server.viewer.shapes import LaidMaterial


class Recorder:
    def __init__(self):
        self.shown = []

    def set_material(self, session_id, material):
        self.shown.append((session_id, material))


def test_a_change_is_drawn_for_those_who_look_at_that_machine():
    scene = Recorder()
    laid = LaidMaterial(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), np.zeros((0, 2, 3)))
    material = {"m001": laid}
    display = JobDisplay(scene, material.get)
    for session_id, machine_id in (("ada", "m001"), ("bob", "m002"), ("vic", "m001")):
        display.watch(session_id, machine_id)
    assert scene.shown == [("ada", laid), ("bob", None), ("vic", laid)]
    display.end_session("vic")
    material.clear()
    display.refresh("m001")
    assert scene.shown[3:] == [("ada", None)]
