"""The package exports all records of its modules."""

from __future__ import annotations

import pickle
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from strainwave import domain as records
from strainwave.domain import Channel, Experiment, Joint, Study
from strainwave.domain.arm.kinds import single_joint


def test_the_package_exports_every_record() -> None:
    groups = [import_module(f"strainwave.domain.{m.name}") for m in iter_modules(records.__path__)]
    # kinds, gear laws, effects and link sensors have lists of their own
    modules = groups + [
        import_module(f"{group.__name__}.{each.name}")
        for group in groups
        for each in iter_modules(getattr(group, "__path__", ()))
        if not each.ispkg and each.name != "effects"
    ]
    defined = {
        kind.__name__: kind
        for module in modules
        for kind in vars(module).values()
        if is_dataclass(kind) and isinstance(kind, type) and kind.__module__ == module.__name__
        if not kind.__name__.startswith("_")
    }
    assert defined == {
        name: kind
        for name, kind in vars(records).items()
        if is_dataclass(kind) and isinstance(kind, type)
    }


def test_records_can_be_pickled() -> None:
    study = Study(
        path=Path("study.toml"),
        sha256="0" * 64,
        arm=single_joint(Joint("linear", 0.01)),
        experiments=(Experiment("swing", "swing.csv", "motion", ("open",)),),
        channels={"t": Channel("time")},
    )
    assert pickle.loads(pickle.dumps(study)) == study
