"""Friction laws. All modules of this folder are imported, which
registers their laws."""

from importlib import import_module
from pkgutil import iter_modules

from curlfit.friction.base import (
    LAWS,
    TERMS,
    Coefficient,
    Edges,
    Law,
    LocalLaw,
    Motion,
    NetLaw,
    Parameter,
    RingPoint,
    coefficient,
    power,
)
from curlfit.friction.registry import find_law
from curlfit.loads import LOADS, Load, check_load, no_motion_because

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

__all__ = [
    "LAWS",
    "LOADS",
    "TERMS",
    "Coefficient",
    "Edges",
    "Law",
    "Load",
    "LocalLaw",
    "Motion",
    "NetLaw",
    "Parameter",
    "RingPoint",
    "check_load",
    "coefficient",
    "find_law",
    "no_motion_because",
    "power",
]
