"""The study as a sweep: its trials as plain data, and the function that makes some of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from allegro_twin import ConfigError
from allegro_twin.files import fingerprint
from allegro_twin.sweep import Sweep
from studies.preemption.arm.trial import ArmBench
from studies.preemption.draws import block, case, object_of
from studies.preemption.protocol import ArmStudy, Set, SpringStudy, Study, study_of
from studies.preemption.registration import EXPLORATORY, contents_of, inputs_of
from studies.preemption.scenes import Job
from studies.preemption.simulate import SpringBench

UNIT = 32
"""Trials in a unit, at most: what may have to be made again after an interruption."""


def sweep_of(study: Study, hands: tuple[str, ...], pairs: int | None = None, registration: str = EXPLORATORY) -> Sweep:
    """The trials of some hands: of train, then as many `pairs` of test, or all, in blocks in which each hand comes
    once: wherever it is cut off, hands, objects and errors have had the same. `registration`: what they are stamped
    with. Raises ConfigError."""
    most = pairs_of(study, pairs)
    items: list[dict[str, Any]] = []
    for set_, count, names in (
        ("train", study.pairs.train, list(study.trained)),
        ("test", most, [policy.name for policy in study.policies]),
    ):
        size = block(study, set_)  # type: ignore[arg-type]  # Either literal.
        for first in range(0, count, size):
            numbers = range(first, min(first + size, count))
            for hand in hands:
                items += [_item(hand, set_, i, policy) for i in numbers for policy in names]
                items += [] if set_ == "train" else _controls(study, hand, numbers)
    contents, inputs = contents_of(study), dict[tuple[str, str], dict[str, str]]()
    for hand in hands:
        for thing in (*study.train, *study.test):
            inputs[hand, thing] = {name: contents[name] for name in inputs_of(study, hand, thing)}
    of = [inputs[item["hand"], object_of(study, item["set"], item["trial"])] for item in items]
    return Sweep("studies.preemption.jobs:made", items, {"study": study.model_dump(mode="json")}, UNIT,
                 {"protocol": study.digest, "registration": registration}, of)  # fmt: skip


def pairs_of(study: Study, pairs: int | None) -> int:
    """So many of test, a hand; None: all. Raises ConfigError."""
    most = study.pairs.test if pairs is None else pairs
    if not 0 <= most <= study.pairs.test:
        raise ConfigError(f"--pairs {most}: the protocol has {study.pairs.test} pairs of test a hand, and no more")
    return most


def _item(hand: str, set_: str, number: int, policy: str, control: str = "") -> dict[str, Any]:
    return {"hand": hand, "set": set_, "trial": number, "policy": policy, "control": control}


def _controls(study: Study, hand: str, numbers: range) -> list[dict[str, Any]]:
    return [
        _item(hand, "test", number, policy, name)
        for name, control in study.controls.items()
        for number in numbers
        if number % control.every == 0
        for policy in control.policies
    ]


def made(shared: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A unit of the sweep: a flat row for each item, which is in it."""
    study = study_of(shared["study"], "the sweep's protocol")
    rows: dict[int, dict[str, Any]] = {}
    for hand in sorted({item["hand"] for item in items}):
        mine = [index for index, item in enumerate(items) if item["hand"] == hand]
        jobs = [_job(study, items[index]) for index in mine]
        rows |= dict(zip(mine, _bench(study, hand).rows(jobs), strict=True))
    return [dict(items[index]) | rows[index] for index in range(len(items))]


def _job(study: Study, item: Mapping[str, Any]) -> Job:
    control = study.controls[item["control"]] if item["control"] else None
    set_: Set = item["set"]
    return Job(study.policy(item["policy"]), case(study, set_, item["trial"], control), control)


_BENCHES: dict[tuple[str, ...], SpringBench | ArmBench] = {}


def _bench(study: Study, hand: str) -> SpringBench | ArmBench:
    """Scenes take a while to make, and a process has many units of them; with other files they are others."""
    key = study.digest, hand, fingerprint(contents_of(study))
    if key not in _BENCHES:
        match study:
            case ArmStudy():
                _BENCHES[key] = ArmBench(study, hand)
            case SpringStudy():
                _BENCHES[key] = SpringBench(study, hand)
    return _BENCHES[key]
