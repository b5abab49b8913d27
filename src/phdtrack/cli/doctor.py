"""``phdtrack doctor``: versions, and what works here."""

from __future__ import annotations

import typer

from phdtrack.cli.options import Json
from phdtrack.cli.output import Output


def doctor(json: Json = False) -> None:
    """Say what works on this machine, and how to mend what does not.

    Exit status 1 where something essential does not work.
    """
    from phdtrack.cli.doctor_checks import examine

    found, out = examine(), Output(json)
    for name, version in found.versions:
        out.say(f"{name:24} {version or 'not installed'}")
    out.say()
    for check in found.checks:
        mark = "ok     " if check.ok else "MISSING" if check.essential else "absent "
        out.say(f"{mark}  {check.name}: {check.detail}")
        if check.cure:
            out.say(f"         {check.cure}")
    out.say()
    out.say("Everything essential works here." if found.ok else "Something essential does not work here: see MISSING above.")
    out.document(found.as_dict())
    if not found.ok:
        raise typer.Exit(1)
