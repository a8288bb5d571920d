"""The console shows the last commissioning of a machine; a damaged or missing one says so."""

from diagnosis.identification.commissioning_record import Commissioning, JointFit
from diagnosis.identification.quantity import Quantity, unknown
from diagnosis.identification.release_delay import ReleaseDelay
from sim_twin.twin.oil_spring import OilSpringDrive

DRIVE = OilSpringDrive(
    dead_time_s=0.1,
    valve_lag_s=0.05,
    natural_frequency_rad_per_s=7.0,
    oil_damping_ratio=0.2,
    friction_damping_ratio=0.1,
)


def fit(joint: str, explained_ratio: float, at_bound: tuple[str, ...]) -> JointFit:
    return JointFit(
        joint=joint,
        drive=DRIVE,
        is_oil_spring=True,
        linear_explained_ratio=0.9,
        explained_ratio=explained_ratio,
        unexplained_by_phase_ratio={"rise": 0.2, "reversal": 0.1, "ringing": 0.7},
        residual_rad_m_per_s=0.02,
        at_bound=at_bound,
        plot={},
    )


def test_a_commissioning_is_shown_with_what_it_left_open(running, ada):
    folder = running.parts.settings.data_dir / "machines"
    folder.mkdir(parents=True, exist_ok=True)
    record, page = folder / "m002.commissioning.json", folder / "m002.commissioning.html"
    path = "/machines/m002/commissioning"
    before = ada.get(path).json()
    assert (before["steps"], before["has_report"], before["problem"]) == ([], False, "")
    assert before["reference"].startswith("no reference throws. At least 12 are needed")
    assert "commission --plant PLANT --machine-id m002 --out" in before["command"]
    assert str(folder) in before["command"]
    assert ada.get(f"{path}/report.html").status_code == 404
    delay = Quantity(unit="s", value=0.257, ci90=(0.25, 0.264), count=39)
    found = Commissioning(
        machine_id="m002",
        joints=(fit("slew", 0.95, ("gain_ratio",)), fit("boom", 0.99, ())),
        release=ReleaseDelay(
            mean=delay,
            sd=unknown("s", "the switch is silent"),
            latch=unknown("s", "no tracker"),
            method="switch",
            delays_s=(),
            single_sd_s=0.01,
            without_switch_count=0,
        ),
    ).done("response", "4 joints")
    record.write_text(found.model_dump_json())
    page.write_text("<p>measured</p>")
    try:
        view = ada.get(path).json()
        steps = {step["name"]: step for step in view["steps"]}
        assert steps["drives"]["words"] == "4 joints"
        assert steps["valve tables"]["done_utc"] is None
        slew, boom = view["joints"]
        assert slew["rest"] == "70 % in what follows, such as ringing"
        assert (slew["at_bound"], boom["at_bound"]) == (["gain_ratio"], [])
        assert {
            "name": "release delay",
            "value": "0.257 s, 90 % interval 0.25 to 0.264, n 39",
        } in view["quantities"]
        assert any("explains 95.0 % of its speed" in flag for flag in view["flags"])
        assert any("gain_ratio is at a bound" in flag for flag in view["flags"])
        report = ada.get(f"{path}/report.html")
        assert report.text == "<p>measured</p>"
        assert "sandbox" in report.headers["Content-Security-Policy"]
        record.write_text("{")
        assert "is no record of a commissioning" in ada.get(path).json()["problem"]
    finally:
        record.unlink()
        page.unlink()


def test_only_known_machines_and_people_who_may_look(running, ada):
    assert ada.get("/machines/none/commissioning").status_code == 404
    with running.client() as nobody:
        assert nobody.get("/machines/m001/commissioning").status_code == 401
