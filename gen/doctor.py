"""`degloss doctor`: what is there and what is missing, each with its remedy."""

from __future__ import annotations

from gen.files import dumps
from gen.parts import APT_LINE, PARTS


def findings() -> dict[str, dict[str, object]]:
    """Every part's state ("ok", "missing", "none"), detail, purpose, remedy, and whether its absence is a fault."""
    found: dict[str, dict[str, object]] = {}
    for name, part in PARTS.items():
        finding = part.look()
        found[name] = {
            "state": finding.state,
            "detail": finding.detail,
            "purpose": part.purpose,
            "remedy": None if finding.state == "ok" else APT_LINE if "shared object" in finding.detail else part.remedy,
            "needed": part.needed,
        }
    return found


def examine(json: bool) -> None:
    """Print the findings, as a table or as one JSON object."""
    found = findings()
    if json:
        print(dumps(found))
        return
    for name, part in found.items():
        mark = {"ok": "ok", "none": "-"}.get(str(part["state"]), "MISSING" if part["needed"] else "absent")
        print(f"{mark:<8}{name:<18}{part['detail']}")
        if part["state"] == "missing":
            print(f"{'':<26}{part['purpose']}")
            print(f"{'':<26}remedy: {part['remedy']}")
