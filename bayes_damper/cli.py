"""The command line: arguments only. Each command is one public call, and prints what its result says of itself."""

from __future__ import annotations

import argparse
import contextlib
import difflib
import functools
import logging
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, NoReturn

import bayes_damper
from bayes_damper.errors import BayesDamperError, ExitCode, InputError, printable
from bayes_damper.inputs import is_file, number_in, real
from bayes_damper.runs.interrupts import interrupts_passed_on
from bayes_damper.runs.memory import seldom_collected
from bayes_damper.text import gathered

Arguments = argparse.Namespace
Adding = Callable[..., argparse.ArgumentParser]  # name, what it runs, help, and `out` where it writes by default
LOG_LEVELS = ("debug", "info", "warning", "error")
LOG = logging.getLogger("bayes_damper.cli")


def _progress(args: Arguments) -> Any:
    from bayes_damper.runs.progress import make_progress

    args.shown = make_progress(quiet=args.quiet or args.json)
    return args.shown


@contextlib.contextmanager
def _closed_afterwards(args: Arguments) -> Iterator[None]:
    """Closes what shows progress, before anything else is printed and whatever happened."""
    try:
        yield
    finally:
        if (shown := getattr(args, "shown", None)) is not None:
            shown.close()


@contextlib.contextmanager
def _nothing_of_this_folder_run() -> Iterator[None]:
    """Processes that start meanwhile import no module from the current folder, where Python would look first."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before


def _demo(args: Arguments) -> Any:
    return bayes_damper.demo(
        out=args.out, seed=args.seed, workers=args.workers, quick=args.quick, progress=_progress(args)
    )


def _examples(args: Arguments) -> Any:
    return bayes_damper.examples(args.out, seed=args.seed)


def _check(args: Arguments) -> Any:
    return bayes_damper.check(args.campaign)


def _simulate(args: Arguments) -> Any:
    return bayes_damper.simulate_record(
        case=args.case,
        campaign=args.campaign,
        coupled=not args.uncoupled,
        settings=args.set or [],
        effect=args.effect,
        rate=args.rate,
        duration=args.duration,
        inputs=args.inputs,
        out=args.out,
        effects_folder=args.effects,
    )


def _fit(args: Arguments) -> Any:
    return bayes_damper.fit(
        args.campaign,
        cases=args.case,
        priors=args.priors,
        normal_force=args.normal_force,
        noise=args.noise,
        effect=args.effect,
        effects=args.effects,
        out=args.out,
        seed=args.seed,
        workers=args.workers,
        scheduler=args.scheduler,
        thorough=args.thorough,
        most_steps=args.most_steps,
        progress=_progress(args),
    )


def _resume(args: Arguments) -> Any:
    return bayes_damper.resume(
        args.folder, more=args.more, effects=args.effects, workers=args.workers, progress=_progress(args)
    )


def _variability(args: Arguments) -> Any:
    return bayes_damper.variability(
        args.folder,
        out=args.out,
        seed=args.seed,
        particles=args.particles,
        repeats=args.repeats,
        unseen=args.unseen,
        adapt=args.adapt,
        workers=args.workers,
        scheduler=args.scheduler,
        progress=_progress(args),
    )


def _compare(args: Arguments) -> Any:
    return bayes_damper.compare(args.folders, out=args.out, seed=args.seed)


_QUESTIONS = (
    ("kind", "Kind of rig: torsional or translational (empty: torsional)"),
    (
        "columns",
        "Columns of the channels, primary first, by number or name, with spaces between (empty: all but the time)",
    ),
    ("time", "Column of the time, by number or name (empty: the one that is called so, or none)"),
    ("sample_rate", "Sample rate in Hz (empty: the time column decides)"),
    ("units", "Their units, e.g. g, m/s^2, rad/s^2, with spaces between (empty: as the file names them, else SI)"),
    ("mounting_radius", "Distance of the sensors from the axis in m (empty: they read angles)"),
    ("primary_inertia", "Inertia J1 in kg m^2 (empty: everything per unit inertia)"),
    ("secondary_inertia", "Inertia J2 in kg m^2 (empty: no second body)"),
    ("bar_radius", "Radius R at which the magnets sit in m (empty: no magnets)"),
    ("magnet_radius", "Radius r of the magnet's face in m (empty: no magnets)"),
    (
        "magnet_pull",
        "Pull N0 of the magnet in N, 9.81 times the kg of a catalogue (empty: nothing rubs between the bodies)",
    ),
    ("k1t", "Stiffness k1t in N m/rad (empty: from the strongest frequency)"),
    ("theta0", "Release angle in degrees (empty: not released at rest, it is inferred)"),
    ("release", "Release: start (of the record), find (in it), first_peak, or s on its clock (empty: start)"),
)


def _init(args: Arguments) -> Any:
    from bayes_damper.campaign.importing.guesses import columns_of
    from bayes_damper.campaign.importing.importer import left_over, records_in

    before = records_in(args.folder)
    given = {key: value for key, value in vars(args).items() if key in args.options and value is not None}
    if args.table is not None:
        beside = [*map(str, args.files), *(f"--{key.replace('_', '-')}" for key in given)]
        if beside:
            raise InputError(
                f"--table {args.table}: the table says all that is done, and {', '.join(beside)} would do nothing; "
                "write that into the table, or leave --table out"
            )
        bayes_damper.import_records(args.table, args.folder, args.raw, args.overwrite)
        return bayes_damper.check(args.folder, left_over(args.folder, before))
    if not args.files and given.get("words"):  # the option takes all that follows: what says no meaning is a file
        args.files = [Path(str(word)) for word in given["words"] if "=" not in str(word)]
        given["words"] = [word for word in given["words"] if "=" in str(word)]
    raw = args.raw or Path()
    lists = [v for v in given.values() if isinstance(v, list)]
    taken = [str(v) for values in lists for v in values if is_file(raw / str(v))]
    if not args.files and taken:
        raise InputError(
            f"no logger files were given: an option took {', '.join(taken[:3])}{', ...' if len(taken) > 3 else ''} for "
            f"its values; name files before the options: bayes-damper init {args.folder} {shlex.join(taken[:3])} --..."
        )
    answers: dict[str, Any] = {}
    if "columns" not in given and sys.stdin.isatty() and sys.stdout.isatty() and not args.quiet:
        if args.files:
            print(columns_of(raw / args.files[0]))
        answers = _answers(set(given), given.get("kind"))
        given |= answers
    try:
        bayes_damper.init_campaign(args.folder, [raw / f for f in args.files], args.overwrite, args.raw, **given)
    except InputError as error:
        if not answers:
            raise
        kept = f"what was answered, to be given again as options: {_as_options(answers)}"
        raise InputError([*error.faults, kept]) from None
    return bayes_damper.check(args.folder, left_over(args.folder, before))


def _as_options(answers: Mapping[str, object]) -> str:
    """Answers as options of a command line."""
    words: list[str] = []
    for key, value in answers.items():
        words += [f"--{key.replace('_', '-')}", *(map(str, value) if isinstance(value, list) else [str(value)])]
    return shlex.join(words)


_OF_TURNING = ("mounting_radius", "bar_radius")
_STRAIGHT = (
    ("Inertia", "Mass"), ("kg m^2", "kg"), ("per unit inertia", "per unit mass"), ("g, m/s^2, rad/s^2", "g, m/s^2, mm"),
    ("N m/rad", "N/m"), ("Release angle in degrees", "Distance in mm from which it is released"),
    ("Stiffness k1t", "Stiffness k1"),
)  # fmt: skip


def _answers(given: set[str], kind: object = None) -> dict[str, Any]:
    """What `init` asks for in a terminal when the columns were not given; an empty answer leaves the default.

    kind : of the rig, where it was given.
    """
    found: dict[str, Any] = {}
    for key, question in _QUESTIONS:
        straight = found.get("kind", kind) == "translational"
        if key in given or (key == "sample_rate" and "time" in found) or (straight and key in _OF_TURNING):
            continue
        for word, other in _STRAIGHT if straight else ():
            question = question.replace(word, other)  # noqa: PLW2901 (the question in the rig's own units)
        words = [_number(w) for w in input(f"{question}: ").split()]
        if words:
            found[key] = words if key in ("columns", "units") else words[0]
    return found


def _at_least(least: int) -> Callable[[str], int]:
    """A reader of whole numbers that are not too small, for options."""

    def read(text: str) -> int:
        if not re.fullmatch("[+-]?[0-9]{1,18}", text.strip()) or int(text) < least:
            fewer = " and of 18 digits at most" if len(text.strip()) > 18 else ""
            raise argparse.ArgumentTypeError(f"{text}: give a whole number, at least {least}{fewer}")
        return int(text)

    return read


_count, _seed = _at_least(1), _at_least(0)


def _number(text: str) -> int | float | str:
    """A number of an option where it is one as a file may have it, else its text."""
    try:
        return int(text) if re.fullmatch("[+-]?[0-9]{1,18}", text) else number_in(text)
    except ValueError:
        return text


def _real(text: str) -> float:
    """A number of an option, within the limits of one in a file."""
    try:
        return real(_number(text), "its value")
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


class _Parser(argparse.ArgumentParser):
    """Says which option or choice a word may mean that is none, and writes the usage of its own command."""

    def error(self, message: str) -> NoReturn:
        """Ends with a sentence and exit code 2."""
        if found := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            words, valid = [found[1]], re.findall(r"[\w-]+", found[2])
        else:
            words = re.findall(r"(?<!\S)--[^\s=]+", message) if message.startswith("unrecognized") else []
            valid = [name for action in self._actions for name in action.option_strings]
        near = [n for word in words for n in difflib.get_close_matches(word.lower()[:60], valid, 1, 0.6)]
        super().error(message + (f"; did you mean {', '.join(dict.fromkeys(near))}?" if near else ""))


class _Completion(argparse.Action):
    """Prints the completion of this command line for a shell, and ends."""

    def __call__(self, parser: Any, _namespace: Any, values: Any, _option: Any = None) -> None:
        import shtab

        for sub in _with_commands(parser):
            for action in sub._actions:  # noqa: SLF001 (argparse shows them in no other way)
                if action.type is Path or action.dest in ("campaign", "folder", "folders"):
                    setattr(action, "complete", shtab.FILE)  # noqa: B010 (where shtab looks; argparse has no such field)
        print(shtab.complete(parser, values))
        parser.exit(0)


def _with_commands(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """A parser and those of its commands."""
    yield parser
    for action in parser._actions:  # noqa: SLF001 (as above)
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            yield from action.choices.values()


class _Once(argparse.Action):
    """Takes what an option is given, and refuses something else a second time: argparse would keep the last."""

    def __call__(self, _parser: Any, namespace: Any, values: Any, option: Any = None) -> None:
        before = vars(namespace).setdefault("given", {}).setdefault(self.dest, values)
        if option is not None and before != values:
            one, two = (" ".join(map(str, v)) if isinstance(v, list) else v for v in (before, values))
            raise argparse.ArgumentError(self, f"given twice, as {one} and as {two}; give it once")
        setattr(namespace, self.dest, values)


class _OneOrEach(_Once):
    """One value for all channels, or one for each of them."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option: Any = None) -> None:
        super().__call__(parser, namespace, values, option)
        setattr(namespace, self.dest, values[0] if len(values) == 1 else values)


def _init_options(sub: argparse.ArgumentParser) -> list[str]:
    """An option for every key of the import's tables, and of [rig] and [measurement], in groups; their names."""
    from bayes_damper import campaign
    from bayes_damper.campaign.importing import options as tables

    left_out = {"source", "sha256", "file", "trial", "holdout"}
    groups = {"files and trials": tables.INIT | tables.TRIAL, "reading the files": tables.READER}
    names = []
    for title, table in groups.items():
        group = sub.add_argument_group(title)
        for key, known in table.items():
            if key in left_out:
                continue
            names.append(key)
            flag, about, types = f"--{key.replace('_', '-')}", known.meaning.replace("%", "%%"), known.types
            if bool in types:
                group.add_argument(flag, action=argparse.BooleanOptionalAction, default=None, help=about)
            elif types == (list,):
                group.add_argument(flag, nargs="+", type=_number, metavar="X", help=about)
            elif list in types:
                group.add_argument(flag, nargs="+", type=_number, metavar="X", help=about, action=_OneOrEach)
            else:
                kind = str if types == (str,) else _number
                group.add_argument(flag, type=kind, metavar="X", help=about)
    others = {
        "the rig": campaign.Rig.__dataclass_fields__, "the measurement": tables.MEASUREMENT,
        "about the campaign": {"name": "name (default: that of the folder)", "description": "description, a sentence",
                               "source_text": "where the data come from, licence"},
    }  # fmt: skip
    for title, keys in others.items():
        group = sub.add_argument_group(title)
        for key in keys:
            names.append(key)
            text = keys[key] if isinstance(keys, dict) and isinstance(keys[key], str) else campaign.COMMENTS[key]
            kind = str if key in ("name", "description", "source_text") else _number
            several: dict[str, Any] = {"nargs": "+", "action": _OneOrEach} if "per channel" in text else {}
            about = text.replace("%", "%%")
            group.add_argument(f"--{key.replace('_', '-')}", type=kind, metavar="X", help=about, **several)
    return names


def _weighed(args: Arguments) -> dict[str, Any]:
    """What every command that weighs effects takes (`weighing`), and where its files and random numbers come from."""
    names = ("nominal", "effects", "priors", "out", "seed", "workers")
    return {name: getattr(args, name) for name in names}


def _diagnose(args: Arguments) -> Any:
    from bayes_damper.runs.progress import make_reporter

    given = _weighed(args) | {"prior_unknown": args.prior_unknown}
    if len(args.campaign) > 1:
        return bayes_damper.diagnose_fleet(args.campaign, scheduler=args.scheduler, progress=_progress(args), **given)
    if args.scheduler is not None:
        raise InputError("--scheduler: it spreads several campaigns over a cluster; leave it out for one")
    return bayes_damper.diagnose(args.campaign[0], report=make_reporter(quiet=args.quiet or args.json), **given)


def _plan(args: Arguments) -> Any:
    return bayes_damper.plan(args.campaign, **_weighed(args))


def _withheld(args: Arguments) -> Any:
    if args.verify is not None:
        from bayes_damper.validation.withheld import verify

        return verify(args.verify, args.folder)
    return bayes_damper.withheld(
        args.folder,
        full=args.full,
        key=args.key,
        workers=args.workers,
        scheduler=args.scheduler,
        seed=args.seed,
        out=args.out,
        effects=args.effects,
        progress=_progress(args),
    )


def _tune(args: Arguments) -> Any:
    from bayes_damper.runs.progress import make_reporter

    return bayes_damper.tune(
        args.folder,
        case=args.case,
        J2=args.secondary_inertia,
        k2t=args.k2t,
        R=args.bar_radius,
        magnet_pull=args.magnet_pull,
        c2t=args.c2t,
        friction_torque=args.friction_torque,
        free=args.free,
        target_db=args.target_db,
        amplitudes=args.torque,
        seed=args.seed,
        effects=args.effects,
        out=args.out,
        report=make_reporter(quiet=args.quiet or args.json),
    )


def _thesis(args: Arguments) -> Any:
    return bayes_damper.recompute(args.out)


def _bench(args: Arguments) -> Any:
    if args.timed == "diagnose":
        from bayes_damper.commands import bench_parts

        found = bench_parts.diagnose_by_parts(args.campaign)
        bench_parts.save(found, args.out)
        return found
    from bayes_damper.validation.bench import save

    result = bayes_damper.bench(repeats=args.repeats, peers=not args.no_peers)
    save(result, args.out)
    return result


def _report(args: Arguments) -> Any:
    return bayes_damper.report(args.folder, out=args.out)


def _command(
    commands: Any, name: str, run: Callable[[Arguments], Any], text: str, *, out: str | None = None
) -> argparse.ArgumentParser:
    """A command with the options that all have."""
    sub: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
    sub.register("action", None, _Once)  # what an argument does that says nothing else
    sub.set_defaults(run=run)
    if out is not None:
        sub.add_argument("--out", type=Path, default=Path(out), help=f"folder for the results (default: {out})")
    sub.add_argument("--seed", type=_seed, default=1, metavar="N", help="seed of all random numbers (default: 1)")
    sub.add_argument("--quiet", action="store_true", help="print errors only: no progress, no summary")
    sub.add_argument("--json", action="store_true", help="print the result as JSON instead of text")
    about = "how much to log to standard error: info names files read and written, debug more (default: warning)"
    sub.add_argument("--log-level", choices=LOG_LEVELS, default="warning", help=about)
    return sub


def _own_effects(sub: argparse.ArgumentParser) -> None:
    about = "folder (or one file) with your own effects or learnt laws"
    sub.add_argument("--effects", type=Path, metavar="DIR", help=about)


def _weighing(sub: argparse.ArgumentParser) -> None:
    about = "linear: leave dry friction out of the nominal model, so that it is a candidate cause (default: nonlinear)"
    sub.add_argument("--nominal", choices=("nonlinear", "linear"), default="nonlinear", help=about)
    _own_effects(sub)
    sub.add_argument("--priors", type=Path, metavar="F.toml", help="priors of the nominal parameters")
    sub.add_argument("--workers", type=_count, default=2, metavar="N", help="parallel processes (default: 2)")


def _workers(sub: argparse.ArgumentParser) -> None:
    about = "parallel processes on this machine (default: 2)"
    sub.add_argument("--workers", type=_count, default=2, metavar="N", help=about)
    sub.add_argument("--scheduler", metavar="ADDRESS", help="run on an existing Dask cluster instead")


def _first_steps(command: Adding) -> None:
    """Commands in the order of a job: an example, a campaign, a plan."""
    command("examples", _examples, "write a small example campaign: a cart with something wrong in its spring",
            out="example")  # fmt: skip

    sub = command("init", _init, "make a campaign from logger files")
    sub.add_argument("folder", type=Path, help="folder of the campaign to write")
    sub.add_argument("files", nargs="*", type=Path, help="logger files, one per trial")
    sub.add_argument(
        "--table", type=Path, metavar="import.toml", help="import table to use instead of files and options"
    )
    sub.add_argument("--raw", type=Path, metavar="DIR", help="folder of the logger files that the table names")
    sub.add_argument(
        "--overwrite",
        action="store_true",
        help="replace the campaign in the folder (records that the new one does not use are kept)",
    )
    sub.set_defaults(options=_init_options(sub))

    sub = command("check", _check, "check a campaign and list every fault in it")
    sub.add_argument("campaign", help="folder of the campaign, or `thesis`")

    sub = command("plan", _plan, "before measuring: which effects the planned trials could show",
                  out="results/plan")  # fmt: skip
    sub.add_argument("campaign", help="folder with campaign.toml and trials.csv; the records need not exist")
    _weighing(sub)

    sub = command("simulate", _simulate, "simulate one noise-free record of your rig, or of the thesis's")
    sub.add_argument(
        "campaign", nargs="?",
        help="folder of a campaign: its rig at the medians of its priors; it may be a plan (default: thesis)",
    )  # fmt: skip
    sub.add_argument("--case", help="case, which gives spring and release (default: the first; of the thesis IV)")
    sub.add_argument("--uncoupled", action="store_true", help="without the second body")
    sub.add_argument(
        "--set",
        action="append",
        metavar="NAME=VALUE",
        help="set a parameter, a key of [rig], or EFFECT.PARAMETER (repeat for several)",
    )
    sub.add_argument("--effect", metavar="NAME", help="add an effect of the library at a typical size")
    _own_effects(sub)
    sub.add_argument("--rate", type=_real, metavar="HZ", help="sample rate (default: the campaign's, else 1000)")
    sub.add_argument(
        "--duration", type=_real, metavar="S", help="length of the record (default: the campaign's, else 1)"
    )
    sub.add_argument(
        "--inputs", type=Path, metavar="F.csv",
        help="measured inputs: time_s and any of torque1_n_m, torque2_n_m, ground_rad, motion1_rad, ...",
    )  # fmt: skip
    sub.add_argument("--out", type=Path, required=True, metavar="F.csv", help="the record to write")


def _fitting(command: Adding) -> None:
    """Commands that fit and diagnose a campaign."""
    sub = command("fit", _fit, "fit the model: parameters with intervals, per case and for all cases together",
                  out="results/fit")  # fmt: skip
    sub.add_argument("campaign", help="folder of the campaign, or `thesis`")
    sub.add_argument("--case", action="append", metavar="C", help="only this case (repeat for several)")
    sub.add_argument("--priors", type=Path, metavar="F.toml", help="prior file to use instead of the default")
    sub.add_argument(
        "--normal-force",
        choices=("linear", "constant"),
        help="how the magnet's pull depends on the overlap of the faces (eq. 20)",
    )
    sub.add_argument("--noise", choices=("auto", "gaussian", "student", "ar"), default="auto",
                     help="noise: white, with outliers (student) or correlated (ar); default: by data")  # fmt: skip
    about = "add this effect to the model, e.g. the one that diagnose named (repeat for two at once)"
    sub.add_argument("--effect", action="append", metavar="NAME", help=about)
    _own_effects(sub)
    sub.add_argument("--thorough", action="store_true", help="run longer: 50 autocorrelation times instead of 20")
    sub.add_argument(
        "--most-steps",
        type=_count,
        metavar="N",
        help="maximum number of steps per ensemble, not counting the warm-up",
    )
    _workers(sub)

    sub = command("diagnose", _diagnose, "find what the model misses: whether, where in the rig, and the likely cause",
                  out="results/diagnose")  # fmt: skip
    sub.add_argument("campaign", nargs="+", help="folder of the campaign, or `thesis`; several give one report for all")
    sub.add_argument("--scheduler", metavar="ADDRESS", help="run several campaigns on an existing Dask cluster")
    sub.add_argument("--prior-unknown", type=_real, default=0.15, metavar="P",
                     help="prior probability that the cause is not in the library (default: 0.15)")  # fmt: skip
    _weighing(sub)


def _using_fits(command: Adding) -> None:
    """Commands that use a fit."""
    sub = command("tune", _tune, "predict insertion loss and resonance shift of a damper design, with uncertainty",
                  out="results/tune")  # fmt: skip
    sub.add_argument("folder", type=Path, help="results folder of a fit")
    sub.add_argument(
        "--case", help="case of the fit to use, or joint for all cases together (default: the only one, else IV)"
    )
    sub.add_argument(
        "--secondary-inertia",
        type=_real,
        metavar="J2",
        help="inertia (mass) of the second body, kg m^2 (kg); default: as on the rig",
    )
    sub.add_argument("--k2t", type=_real, help="stiffness of the coupling, N m/rad (N/m); default: as fitted")
    sub.add_argument("--c2t", type=_real, help="damping of the coupling, N m s/rad (N s/m); default: as fitted")
    sub.add_argument(
        "--bar-radius",
        type=_real,
        metavar="R",
        help="radius of the magnet's bar, m; k2t grows with its square (eq. 21)",
    )
    sub.add_argument("--magnet-pull", type=_real, metavar="N0", help="pull of the magnet, N; default: as on the rig")
    about = "dry friction between the bodies at full overlap, N m (force, N); default: as fitted"
    sub.add_argument("--friction-torque", type=_real, metavar="F", help=about)
    about = "what the search for the best design changes, of J2, k2t, R and c2t (default: J2, k2t and R)"
    sub.add_argument("--free", nargs="+", metavar="NAME", help=about)
    sub.add_argument("--torque", type=_real, nargs="+", metavar="T",
                     help="amplitudes of the exciting torque, N m (force, N); default: to suit the rig")  # fmt: skip
    _own_effects(sub)
    sub.add_argument(
        "--target-db", type=_real, default=10.0, metavar="DB", help="insertion loss to reach, dB (default: 10)"
    )

    sub = command("variability", _variability, "show what the cases of a fit have in common and where they differ")
    sub.add_argument("folder", help="results folder of a fit, or `thesis`")
    sub.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default: the same folder)")
    sub.add_argument(
        "--particles", type=_count, default=288, metavar="N", help="particles (draws) per run (default: 288)"
    )
    sub.add_argument("--repeats", type=_count, default=2, metavar="N", help="runs per model (default: 2)")
    sub.add_argument("--unseen", action=argparse.BooleanOptionalAction, default=True,
                     help="also with other priors and friction laws, and each case left out (thesis only)")  # fmt: skip
    sub.add_argument("--adapt", action=argparse.BooleanOptionalAction, default=True,
                     help="use up to 1024 particles where repeated runs differ (thesis only)")  # fmt: skip
    _workers(sub)


def _results(command: Adding) -> None:
    """Commands about folders of results."""
    sub = command("compare", _compare, "compare several results")
    sub.add_argument("folders", nargs="+", metavar="FOLDER", help="results folders")
    sub.add_argument("--out", type=Path, metavar="DIR", help="also write comparison.json and a figure to this folder")

    sub = command("report", _report, "write one HTML page from all results in a folder")
    sub.add_argument("folder", type=Path, help="results folder")
    sub.add_argument("--out", type=Path, metavar="F.html", help="page to write (default: report.html in the folder)")

    sub = command("resume", _resume, "continue an interrupted run, or extend a finished one (--more)")
    sub.add_argument("folder", type=Path, help="results folder of the run")
    sub.add_argument("--more", action="store_true", help="extend a finished run")
    about = "folder with your own effects, if the run used any (results folders are never run as code)"
    sub.add_argument("--effects", type=Path, metavar="DIR", help=about)
    sub.add_argument("--workers", type=_count, metavar="N", help="parallel processes (default: as before)")


def _proofs(command: Adding) -> None:
    """The thesis, and checks of the program itself."""
    sub = command("demo", _demo, "fit the thesis's data, compare its cases and write a report", out="results/demo")
    sub.add_argument("--quick", action="store_true", help="a tenth of the draws, for a first look (marked as such)")
    _workers(sub)

    command("thesis", _thesis, "recompute every table and figure of the thesis and compare with the printed numbers",
            out="results/thesis")  # fmt: skip

    sub = command("withheld", _withheld, "blind test: diagnose campaigns with sealed causes, then score the answers",
                  out="results/withheld")  # fmt: skip
    sub.add_argument("folder", nargs="?", type=Path, help="folder of campaigns (default: those shipped)")
    sub.add_argument(
        "--full",
        action="store_true",
        help="all campaigns, and each again with its cause removed from the library (hours)",
    )
    sub.add_argument(
        "--key",
        type=Path,
        metavar="F.json",
        help="file with the true causes (default: FOLDER_key.json beside the folder)",
    )
    sub.add_argument(
        "--verify",
        type=Path,
        metavar="F.zip",
        help="check the seals of a finished run's archive, and of its campaigns in FOLDER",
    )
    _own_effects(sub)
    _workers(sub)

    sub = command("bench", _bench, "measure speed and accuracy here, and of other packages that are installed",
                  out="results/bench")  # fmt: skip
    sub.add_argument("--repeats", type=_count, default=7, metavar="N", help="number of rounds (default: 7)")
    sub.add_argument("--no-peers", action="store_true", help="leave the other packages out")
    sub.add_argument(
        "--command", dest="timed", choices=["diagnose"], help="instead, show where this command spends its time"
    )
    sub.add_argument("--campaign", type=Path, metavar="DIR", help="campaign for --command (default: a shipped one)")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="bayes-damper",
        description="Fit the model of a damped rig to measured free decays, with the uncertainty of each parameter, "
        "and find out where and why the model and the rig differ. Start with: bayes-damper examples",
        epilog="Exit codes: 0 done, 2 bad input, 3 did not converge (results written and marked), 4 a self-check "
        "failed, 130 interrupted (state saved).",
    )
    parser.add_argument("--version", action="version", version=_version())
    parser.add_argument(
        "--print-completion",
        action=_Completion,
        choices=("bash", "zsh", "tcsh"),
        help="print the completion script for that shell",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    for add in (_first_steps, _fitting, _using_fits, _results, _proofs):
        add(functools.partial(_command, commands))
    return parser


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("bayes-damper")
    except PackageNotFoundError:
        return "0 (not installed)"


def _written_out(word: str) -> str:
    """A negative number with an exponent without it: argparse takes -1e-3 for an option, and -0.001 for a number."""
    return f"{Decimal(word):f}" if re.fullmatch(r"-(\d+\.?\d*|\.\d+)[eE][-+]?\d{1,3}", word) else word


def _log_from(level: str) -> None:
    """The package's own log from this level on, to standard error."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    log = logging.getLogger("bayes_damper")
    log.handlers[:] = [handler]
    log.setLevel(level.upper())


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; its exit code (see --help)."""
    words = [_written_out(word) for word in (sys.argv[1:] if argv is None else argv)]
    parser = _parser()
    args, rest = parser.parse_known_args(words or ["--help"])
    if rest and (args.command != "init" or any(word.startswith("-") for word in rest)):
        own = next(sub for sub in _with_commands(parser) if sub.prog == f"{parser.prog} {args.command}")
        own.error(f"unrecognized arguments: {' '.join(rest)}")
    if rest:  # files behind the options
        args.files += map(Path, rest)
    _log_from(args.log_level)
    LOG.info("bayes_damper %s, %s, seed %s", _version(), args.command, args.seed)
    try:
        with seldom_collected(), interrupts_passed_on(), _closed_afterwards(args), _nothing_of_this_folder_run():
            result = args.run(args)
    except BayesDamperError as error:
        said = "\n".join(gathered(error.faults)) if isinstance(error, InputError) else str(error)
        print(f"bayes-damper {args.command}: {said}", file=sys.stderr)
        return int(error.exit_code)
    except OSError as error:  # a folder that cannot be written, a full disk
        place = f"{error.filename}: " if error.filename else ""
        reason = error.strerror or type(error).__name__
        print(f"bayes-damper {args.command}: {place}{reason}; choose another place, e.g. with --out", file=sys.stderr)
        return int(ExitCode.BAD_INPUT)
    except MemoryError:
        reason = "the memory of this machine, or what it allows one process, is used up"
        print(
            f"bayes-damper {args.command}: {reason}; give fewer trials or readings (every = N in [measurement] of "
            "campaign.toml), fewer --workers, or more memory",
            file=sys.stderr,
        )
        return int(ExitCode.BAD_INPUT)
    except KeyboardInterrupt:
        print(f"bayes-damper {args.command}: stopped; the same command begins it again", file=sys.stderr)
        return int(ExitCode.INTERRUPTED)
    if not args.quiet:
        from bayes_damper.runs.json_files import json_text

        print(json_text(result.to_json()) if args.json else printable(result.text()))
    return int(result.exit_code)


if __name__ == "__main__":
    sys.exit(main())
