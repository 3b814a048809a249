# ruff: noqa: T201  (a script of its own, in no package, that talks to the terminal)
"""Makes campaigns whose cause is withheld.

    python validation/simulator/make.py --kind easy --effect knock --level 0.5 --seed 7 --out FOLDER
    python validation/simulator/make.py --set easy --seed 7 --out FOLDER --workers 2
    python validation/simulator/make.py --kind hard --effect library --effect none*20 --level 0.5 --seed 7 --out FOLDER
    python validation/simulator/make.py --list

--effect takes a name, "a+b" for two at once, a group (library, development, reserved, foreign, none, pairs, random),
each followed by *N for N of them. The key is written beside the folder, as FOLDER_key.json, never into it.
"""

import argparse
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
if str(HERE) not in sys.path:
    sys.path.insert(0, str(HERE))

from rig.campaign import Order, make_campaign  # noqa: E402
from rig.kinds import KINDS  # noqa: E402
from rig.sets import LEVELS, orders, write_set  # noqa: E402

__all__ = ["KINDS", "LEVELS", "SETS", "Order", "make_campaign", "orders", "write_set"]

# kinds outside the library that were kept for the proof when the shipped campaigns were made
SHIPPED_FOREIGN = (
    "one_sided_spring",
    "stiffness_ripple",
    "one_way_drag",
    "race_dent",
    "face_stop",
    "pull_tilt",
    "stray_iron",
    "second_knock",
    "bar_paddle",
    "release_rebound",
    "warming_offset",
    "logger_hold",
    "curved_gain",
    "sagging_gain",
)
# name -> kinds, effects, levels, pairs at each level
SETS: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[float, ...], int]] = {
    "development": (("easy", "hard"), ("library", "none*20", "development"), (0.15, 0.5, 1.0), 0),
    "easy": (("easy",), ("library*2", "none*100", "foreign"), (0.15, 0.3, 0.5, 1.0, 2.0), 0),
    "faint": (("easy",), ("library", "foreign"), (0.05, 0.1), 0),
    "hard": (("hard",), ("library*4", "none*100", "foreign*2"), (0.15, 0.5, 1.0), 0),
    "pairs": (("easy", "hard"), ("pairs",), (0.5, 1.0), 20),
    "shipped": (("easy", "hard"), ("library", "none*3", *SHIPPED_FOREIGN), (0.5, 1.0), 0),  # with --limit 36
}


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", choices=sorted(SETS), help="a whole set; --kind and --level narrow it")
    parser.add_argument("--kind", action="append", choices=("easy", "hard"))
    parser.add_argument("--effect", action="append")
    parser.add_argument("--level", action="append", type=float)
    parser.add_argument("--pairs", type=int, default=None, help="pairs a level, for the group pairs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--key", type=Path, help="default: OUT_key.json beside the folder")
    parser.add_argument("--duration", type=float, default=1.0, help="s of each record")
    parser.add_argument(
        "--trigger",
        choices=("late", "early", "either"),
        default="late",
        help="hard kind: the logger starts up to 1 ms after the release, before it, or either",
    )
    parser.add_argument("--limit", type=int, help="make only the first N of the shuffled set")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--salt", help="fixes the names; drawn when absent")
    parser.add_argument("--list", action="store_true", help="list the disturbances")
    parser.add_argument("--quiet", action="store_true")
    given = parser.parse_args(arguments)
    if given.list:
        for k in KINDS.values():
            print(f"{k.name:24s}{k.site:12s}{k.standing:13s}{k.meaning}")
        return 0
    if given.out is None:
        parser.error("--out is required")
    kinds, effects, levels, pairs = SETS.get(given.set or "", (("easy",), ("random",), (0.5,), 1))
    try:
        wanted = orders(
            given.kind or kinds,
            given.effect or effects,
            given.level or levels,
            given.seed,
            pairs if given.pairs is None else given.pairs,
            given.duration,
            given.trigger,
        )
    except ValueError as fault:
        parser.error(str(fault))
    out = given.out.resolve()
    key = given.key or out.parent / f"{out.name}_key.json"
    tell = None if given.quiet else print
    write_set(wanted[: given.limit], out, key, given.workers, given.salt, tell)
    return 0


if __name__ == "__main__":
    sys.exit(main())
