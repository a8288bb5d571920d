"""The first start of a demo in an empty folder: it measures its machine, and an operator can sign in."""

from pathlib import Path

from tests.e2e.measured_machine import keep
from tests.e2e.stack import Demo, client


def test_a_demo_measures_its_machine_at_its_first_start(tmp_path: Path) -> None:
    demo = Demo(tmp_path)
    demo.start()
    try:
        with client(demo.ready(), "operator") as api:
            machine = api.get("/machines/m001").json()
            assert machine["link"]["is_connected"]
            assert {mode["mode"] for mode in machine["reach"]["modes"]} == {"2d", "3d"}
            names = {one["name"] for one in api.get("/machines/m001/site").json()["objects"]}
            assert names == {"truck bed", "pit"}
    finally:
        demo.stop()
    # The browser tests throw with it.
    keep(demo.machines)
