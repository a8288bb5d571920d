import sys
from pathlib import Path

import pytest

from machine.errors import UsageError
from machine.spec import load_spec
from sim_twin.throws import plants
from sim_twin.throws.plants import plant_maker
from sim_twin.twin.profile import nominal_profile
from sim_twin.twin.twin import Twin
from sim_twin.virtual_machine import VirtualMachine

SPEC = load_spec()


def maker(name: str, unit_seed: int = 0, **options: object) -> plants.PlantMaker:
    given = {"profile": None, "calibration": None, **options}
    return plant_maker(name, unit_seed=unit_seed, spec=SPEC, **given)


def test_known_plants_are_made_with_their_size() -> None:
    twin, virtual = maker("twin")(3), maker("virtual", 2)(2)
    assert isinstance(twin, Twin)
    assert isinstance(virtual, VirtualMachine)
    assert (twin.count, virtual.count) == (3, 2)


def test_the_twin_takes_its_profile() -> None:
    profile = nominal_profile(SPEC).model_copy(update={"version_count": 4})
    twin = maker("twin", profile=profile)(1)
    assert isinstance(twin, Twin)
    assert twin.profile.version_count == 4


def test_a_plant_of_another_package_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "yard_plant.py").write_text(
        "from sim_twin.twin.twin import Twin\nclass Yard(Twin):\n"
        "    def __new__(cls, *, count, unit_seed):\n"
        "        return Twin.for_plant(count=count, unit_seed=0)\n"
        "class Nothing:\n    def __init__(self, *, count, unit_seed): pass\n"
        "class Other:\n    pass\n"
        "class Broken:\n    def __init__(self, *, count, unit_seed):\n        len(count)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    try:
        assert maker("yard_plant:Yard", 5)(2).count == 2
        with pytest.raises(
            UsageError, match=r"Nothing has no count, now_ns\(\).*collided\(\): add"
        ):
            maker("yard_plant:Nothing")(1)
        with pytest.raises(UsageError, match="take the keywords count, unit_seed"):
            maker("yard_plant:Other")(1)
        with pytest.raises(UsageError, match=r"raised TypeError: .* line 11, in __init__"):
            maker("yard_plant:Broken")(1)
        with pytest.raises(UsageError, match="no class Missing"):
            maker("yard_plant:Missing")
    finally:
        sys.modules.pop("yard_plant", None)


def test_names_and_options_that_cannot_work() -> None:
    with pytest.raises(UsageError, match="no plant 'gazebo'; use twin, virtual"):
        maker("gazebo")
    with pytest.raises(UsageError, match="cannot be imported"):
        maker("no_such_package.plant:Class")
    with pytest.raises(UsageError, match="no unit 3"):
        maker("twin", 3)
    with pytest.raises(UsageError, match="no effect on --plant virtual"):
        maker("virtual", profile=nominal_profile(SPEC))
