"""Say which OpenGL, ffmpeg and versions work on this machine, and how to mend what does not."""

from __future__ import annotations

import argparse

from tensegrity_mj.commands.common import ExitCode, Outcome

HELP = "say what works on this machine and how to mend what does not"
EXAMPLES = """\
example:
  tensegrity-mj doctor

It exits 0 when everything works that simulation and video need, and 5 otherwise.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """No options of its own."""


def execute(options: argparse.Namespace) -> Outcome:
    """Run every check."""
    from dataclasses import asdict

    from tensegrity_mj.doctor import examine

    checks = examine()
    healthy = all(check.works for check in checks if check.required)
    width = max(len(check.name) for check in checks)
    lines = []
    for check in checks:
        mark = "ok" if check.works else ("MISSING" if check.required else "absent")
        lines.append(f"{mark:<8}{check.name:<{width}}  {check.found}")
        if not check.works:
            lines.append(f"{'':<{width + 10}}needed for {check.needed_for}; {check.remedy}")
    lines.append("Everything needed works." if healthy else "Something needed is missing: see above.")
    data = {"status": "ok" if healthy else "missing", "checks": [asdict(check) for check in checks]}
    return Outcome(data, "\n".join(lines), ExitCode.SUCCESS if healthy else ExitCode.MISSING_LIBRARY)
