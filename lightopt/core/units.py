"""Length units of files; inside the package everything is millimetres and radians."""

import re
from collections.abc import Mapping

# millimetres in one unit, by the unit's name in YAML files
MM_PER_UNIT: Mapping[str, float] = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4, "ft": 304.8}

_CONTEXT = re.compile(rb"GLOBAL_UNIT_ASSIGNED_CONTEXT\s*\(\s*\(([^)]*)\)")
_SI = re.compile(rb"SI_UNIT\s*\(\s*(\$|\.\w+\.)\s*,\s*\.METRE\.\s*\)")
_NAMED = re.compile(rb"CONVERSION_BASED_UNIT\s*\(\s*'(\w*)'")
_SI_MM = {b"$": 1e3, b".MICRO.": 1e-3, b".MILLI.": 1.0, b".CENTI.": 10.0, b".DECI.": 100.0, b".KILO.": 1e6}
_NAMED_MM = {
    **dict.fromkeys((b"INCH", b"INCHES", b"IN"), 25.4),
    **dict.fromkeys((b"FOOT", b"FEET", b"FT"), 304.8),
    b"MILLIMETRE": 1.0,
    b"CENTIMETRE": 10.0,
    b"METRE": 1000.0,
}


def step_units_mm(data: bytes) -> frozenset[float]:
    """Length units that the geometry of a STEP file is in [mm], as it declares them (ISO 10303-21, -41); usually one.

    Units that only define others (an inch is defined in mm) are none of the geometry's. Empty where none is declared,
    or none that is known.
    """
    used = {number for refs in _CONTEXT.findall(data) for number in re.findall(rb"#\s*(\d+)", refs)}
    units: set[float | None] = set()
    for match in re.finditer(rb"\bLENGTH_UNIT\b", data):
        start = data.rfind(b";", 0, match.start()) + 1
        statement = data[start : data.find(b";", match.end())]
        number = re.search(rb"#\s*(\d+)\s*=", statement)
        if number is None or number[1] not in used:
            continue
        if si := _SI.search(statement):
            units.add(_SI_MM.get(si[1]))
        elif named := _NAMED.search(statement):
            units.add(_NAMED_MM.get(named[1].upper()))
    return frozenset(unit for unit in units if unit is not None)


def unit_name(mm: float) -> str:
    """Name of the unit of so many millimetres, as in YAML files where it has one there.

    Examples
    --------
    >>> unit_name(25.4), unit_name(1e6), unit_name(3.0)
    ('inch', 'km', 'units of 3 mm')
    """
    names = {value: name for name, value in MM_PER_UNIT.items()} | {100.0: "dm", 1e6: "km"}
    return names.get(mm, f"units of {mm:g} mm")
