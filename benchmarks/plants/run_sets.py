"""Diagnose the sets of `make_sets.py` and count right answers.

    python -m benchmarks.plants.run_sets OUT [--plant ring|mule] [--no-reference] [--no-profile] [--resume]

Each set is diagnosed by ``downrange diagnose throws`` against its machine's reference throws. Answers are
written to ``OUT/answers/``; the truth is read only to count. Intervals are Wilson's, 95 %.
"""

import argparse
import json
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from benchmarks.plants.contents import PLANTS
from benchmarks.plants.make_sets import ThrowSet, run, unit_folder
from benchmarks.result_file import Row, describe, ratio, row, write_result
from diagnosis.loading.kept_reference import kept_reference

EffectSet = frozenset[tuple[str, str | None]]
"""Effects by name and joint."""
NO_EFFECT: Final[EffectSet] = frozenset()


def effect_set(effects: Sequence[dict[str, Any]]) -> EffectSet:
    """Names and joints of effects of the truth or of an answer."""
    return frozenset((effect["effect"], effect.get("joint")) for effect in effects)


def named(answer: dict[str, Any]) -> EffectSet:
    """What the answer names first; nothing unless it is explained."""
    causes = answer.get("causes") or []
    return (
        effect_set(causes[0]["effects"])
        if answer["verdict"] == "explained" and causes
        else NO_EFFECT
    )


def members(answer: dict[str, Any]) -> list[EffectSet]:
    """The candidates of an ambiguous answer: those listed with effects, else its two likeliest causes."""
    if answer["verdict"] != "ambiguous":
        return []
    listed = [effect_set(found) for found in _effect_lists(answer.get("ambiguity"))]
    causes = [cause for cause in answer.get("causes") or [] if cause.get("name") != "unknown"]
    return listed or [effect_set(cause["effects"]) for cause in causes[:2]]


def _effect_lists(data: object) -> Iterator[list[dict[str, Any]]]:
    """Every list under a key `effects` that holds objects with a key `effect`."""
    if isinstance(data, dict):
        for key, value in data.items():
            if key == "effects" and isinstance(value, list):
                if all(isinstance(item, dict) and "effect" in item for item in value):
                    yield value
            else:
                yield from _effect_lists(value)
    elif isinstance(data, list):
        for item in data:
            yield from _effect_lists(item)


def judge(truth: ThrowSet, answer: dict[str, Any]) -> dict[str, bool]:
    """What of an answer is right, by name; which of them matter depends on the kind of set."""
    verdict, right = answer["verdict"], effect_set(truth.effects)
    found, candidates = named(answer), members(answer)
    match truth.kind:
        case "healthy":
            return {
                "none": verdict == "none",
                "effect claimed": verdict in ("explained", "unknown"),
            }
        case "unknown":
            return {
                "flagged unknown": verdict == "unknown",
                "named a known effect": verdict == "explained",
                "none": verdict == "none",
            }
        case "single" | "pair":
            return {
                "exact": found == right,
                "exact, or one of two candidates": found == right
                or (len(candidates) <= 2 and right in candidates),
                "at least one effect right": bool(found & right)
                or any(c & right for c in candidates),
                "wrong effect claimed": bool(found - right),
                "none": verdict == "none",
                "unknown": verdict == "unknown",
            }


def rows(
    sets: Sequence[ThrowSet], answers: Sequence[dict[str, Any]], reference_throws: str
) -> list[Row]:
    """Shares by kind of set and judgement; `reference_throws` labels them: ``kept`` or ``none``."""
    made: list[Row] = []
    for kind in ("healthy", "single", "pair", "unknown"):
        judged = [judge(t, a) for t, a in zip(sets, answers, strict=True) if t.kind == kind]
        for name in judged[0] if judged else ():
            right = sum(one[name] for one in judged)
            labels = {"reference_throws": reference_throws, "sets": kind, "answer": name}
            values = {"count": right, "share_ratio": ratio(right, len(judged))}
            made.append(row(len(judged), labels, values))
    return made


def diagnose(
    plant: str, out: Path, one: ThrowSet, *, with_reference: bool, with_profile: bool, resume: bool
) -> dict[str, Any]:
    """Answer for one set; with `resume`, from its file where there is one."""
    folder = unit_folder(out, one.unit)
    kind = (
        f"{'reference' if with_reference else 'alone'}-{'profile' if with_profile else 'nominal'}"
    )
    file = out / "answers" / kind / f"{one.name}.json"
    if not (resume and file.exists()):
        file.parent.mkdir(parents=True, exist_ok=True)
        arguments = ["diagnose", "throws", str(out / "sets" / one.name), "--json", str(file)]
        kept = kept_reference(folder, plant).folder
        arguments += ["--reference", str(kept) if with_reference else "none"]
        if with_profile:
            arguments += ["--profile", str(folder / f"{plant}.profile.json")]
        run(arguments)
    answer = json.loads(file.read_text(encoding="utf-8"))
    print(one.name, answer["verdict"], answer["sentence"], flush=True)
    return answer


def main() -> None:
    """Diagnose all sets in parallel and write the counts."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--plant", choices=sorted(PLANTS), default="ring")
    parser.add_argument("--no-reference", action="store_true", help="without reference throws")
    parser.add_argument("--no-profile", action="store_true", help="with the nominal twin")
    parser.add_argument("--resume", action="store_true", help="keep the answers that are there")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--json", type=Path, help="result file (default: benchmarks/results/plant_PLANT.json)"
    )
    options = parser.parse_args()
    plant: str = options.plant
    out: Path = options.out.resolve()
    data = json.loads((out / "truth.json").read_text(encoding="utf-8"))
    sets = [ThrowSet(**item) for item in data]
    how = {"with_reference": not options.no_reference, "with_profile": not options.no_profile}
    with ThreadPoolExecutor(options.jobs) as pool:
        answers = list(
            pool.map(lambda one: diagnose(plant, out, one, **how, resume=options.resume), sets)
        )
    for one, answer in zip(sets, answers, strict=True):
        truth = (
            ", ".join(f"{e['effect']} {e['joint'] or ''}".strip() for e in one.effects) or "healthy"
        )
        found = ", ".join(
            f"{name} {joint or ''}".strip() for name, joint in sorted(named(answer), key=str)
        )
        print(f"{one.name} {one.kind:8} {truth:45} {answer['verdict']:10} {found}")
    table = rows(sets, answers, "none" if options.no_reference else "kept")
    for line in table:
        value = line.values["share_ratio"]
        print(
            *line.labels.values(),
            f"{line.values['count'].value:.0f} of {line.n}",
            value.low,
            value.high,
        )
    notes = f"Independent plant `{plant}`; " + ", ".join(f"{k}: {v}" for k, v in how.items())
    result = describe(
        f"plant_{plant}", f"Diagnosis on the plant `{plant}`", table, seed=1, notes=notes
    )
    write_result(result, options.json)


if __name__ == "__main__":
    main()
