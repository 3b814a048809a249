"""Makes campaigns of drawn laboratories.

    python -m validation.laboratories none*20 --seed 7 --out FOLDER                sound laboratories
    python -m validation.laboratories none*50 library*30 foreign*20 --seed 7 --out FOLDER --workers 2
    python -m validation.laboratories spring_cubic --level 1 --strength 1 --repeats --bodies 2 --seed 7 --out FOLDER
    python -m validation.laboratories --again KEY --out FOLDER                     the campaigns of a key once more
    python -m validation.laboratories --list

Each campaign goes to FOLDER/<hash>; the key goes beside the folder, to FOLDER_key.json, never into it.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .campaign import again, orders, write_set
from .kinds import KINDS


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.laboratories",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("cause", nargs="*", help='none, library, foreign or a kind; "a+b" for two at once, "*N" for N')
    parser.add_argument(
        "--level", type=float, default=0.0, help="of the gap, against noise and scatter; drawn if absent"
    )
    parser.add_argument("--strength", type=float, help="of every scatter over the typical one; drawn if absent")
    parser.add_argument("--repeats", action=argparse.BooleanOptionalAction, help="drawn if absent")
    parser.add_argument("--bodies", type=int, choices=(1, 2), help="drawn if absent")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--salt", help="fixes the names; drawn when absent")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--key", type=Path, help="default: OUT_key.json beside the folder")
    parser.add_argument("--again", type=Path, metavar="KEY", help="make the campaigns of this key once more")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--list", action="store_true", help="list the kinds")
    parser.add_argument("--quiet", action="store_true")
    given = parser.parse_args(arguments)
    if given.list:
        for k in KINDS.values():
            _say(f"{k.name:24s}{k.site:12s}{k.standing:10s}{k.formula}")
        return 0
    if given.out is None:
        parser.error("--out is required")
    out = given.out.resolve()
    if given.again:
        again(given.again, out, given.workers)
        return 0
    try:
        wanted = orders(given.cause, given.seed, given.level, given.strength, given.repeats, given.bodies)
    except ValueError as fault:
        parser.error(str(fault))
    if not wanted:
        parser.error("name at least one cause, for example none*20")
    write_set(
        wanted,
        out,
        given.key or out.parent / f"{out.name}_key.json",
        given.workers,
        given.salt,
        (lambda _: None) if given.quiet else _say,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
