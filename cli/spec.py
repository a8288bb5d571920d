"""`downrange spec`: regenerate machine/spec.json from the MJCF."""

from machine.spec import SPEC_PATH
from sim_twin.spec_export import build_spec, write_spec


def run(*, check: bool = False) -> int:
    """Write machine/spec.json from machine/m545.xml; its diff is the safety review.

    Args:
        check: write nothing, exit 1 if the file on disk differs.
    """
    if check:
        same = SPEC_PATH.read_text(encoding="utf-8").strip() == build_spec().model_dump_json(
            indent=2
        )
        print("spec.json agrees with m545.xml" if same else "spec.json differs: run `make spec`")
        return 0 if same else 1
    write_spec()
    print(f"wrote {SPEC_PATH}")
    return 0
