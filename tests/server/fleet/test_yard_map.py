import math

import pytest
from sqlalchemy import select

from cli.service.demo import MACHINE_DISTANCE_M, DemoSetup, place_on_map
from machine.site.objects import SiteKind, SiteObject
from server.errors import NotFoundError
from server.fleet.yard_map import IMPACT_COUNT, PlaceRequest, YardMap
from server.schemas.console import Role
from server.schemas.sites import SiteRequest
from server.store.enrolment_models import MachinePlace
from tests.server.fleet.test_machine_summaries import add_throws


@pytest.fixture
def yard(assembled):
    parts = assembled.parts
    for machine_id in ("m001", "m002"):
        parts.registry.get(machine_id).is_listed = True
    return YardMap(parts.database, parts.audit, parts.registry, parts.sites, parts.zones)


def test_a_machine_is_placed_moved_and_taken_off_and_stays_in_the_fleet(yard, assembled):
    sue = assembled.session("sue", Role.SUPERVISOR)
    assert [found.place for found in yard.machines()] == [None, None]
    yard.place("m001", PlaceRequest(x_m=1.0, y_m=2.0), sue)
    yard.place("m001", PlaceRequest(x_m=30.0, y_m=-4.5, heading_rad=math.pi / 2), sue)
    first, second = yard.machines()
    assert first.place is not None and second.place is None
    assert (first.place.x_m, first.place.y_m) == (30.0, -4.5)
    assert first.place.heading_rad == pytest.approx(math.pi / 2)
    assert first.place.changed_by == "sue"
    yard.remove("m001", sue)
    assert [found.machine_id for found in yard.machines() if found.place is None] == [
        "m001",
        "m002",
    ]
    with pytest.raises(NotFoundError):
        yard.place("m099", PlaceRequest(x_m=0.0, y_m=0.0), sue)


def test_the_map_has_objects_and_the_newest_impacts_in_the_machines_frame(yard, assembled):
    parts = assembled.parts
    box = SiteObject(
        name="truck", kind=SiteKind.BOX, x_m=9.0, y_m=0.0, length_m=4.0, width_m=2.0, height_m=1.0
    )
    request = SiteRequest(objects=(box,), from_version_count=0)
    parts.sites.change("m001", request, assembled.session())
    add_throws(parts, IMPACT_COUNT, 5.0)
    add_throws(parts, 1, 0.0, measured_downrange_error_m=None, measured_crossrange_error_m=None)
    add_throws(parts, 1, 0.5, target_x_m=0.0, target_y_m=8.0, measured_crossrange_error_m=0.25)
    first, second = yard.machines()
    assert [found.name for found in first.objects] == ["truck"]
    assert len(first.impacts) == IMPACT_COUNT
    newest = first.impacts[0]
    # The target lies to the left of the machine: long is along y, left is against x.
    assert (newest.x_m, newest.y_m) == (pytest.approx(-0.25), pytest.approx(8.5))
    assert first.impacts[1].x_m == pytest.approx(14.0)
    assert (second.objects, second.zones, second.impacts) == ((), (), ())


def test_the_demo_puts_its_machines_side_by_side(running):
    settings = running.settings
    setup = DemoSetup(settings.data_dir, settings.policies_dir, settings.port_count, 0)
    place_on_map(setup, ["m001", "m002"])
    with running.parts.database.read() as database:
        places = {
            row.machine_id: (row.x_m, row.y_m) for row in database.scalars(select(MachinePlace))
        }
    assert places["m001"] == (0.0, 0.0)
    assert places["m002"] == (MACHINE_DISTANCE_M, 0.0)
