"""The command line: arguments only. Each command is one public call, and prints what its result says of itself."""

from __future__ import annotations

import argparse
import contextlib
import functools
import logging
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

from bayes_damper.errors import BayesDamperError, ExitCode, InputError, printable
from bayes_damper.inputs import is_file
from bayes_damper.runs.memory import seldom_collected

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


def _demo(args: Arguments) -> Any:
    from bayes_damper.commands.demo import demo

    return demo(out=args.out, seed=args.seed, workers=args.workers, quick=args.quick, progress=_progress(args))


def _examples(args: Arguments) -> Any:
    from bayes_damper.commands.examples import examples

    return examples(args.out, seed=args.seed)


def _check(args: Arguments) -> Any:
    from bayes_damper.commands.check import check

    return check(args.campaign)


def _simulate(args: Arguments) -> Any:
    from bayes_damper.commands.simulate import simulate_record

    return simulate_record(
        case=args.case,
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
    from bayes_damper.fit import fit

    return fit(
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
    from bayes_damper.commands.resume import resume

    return resume(args.folder, more=args.more, effects=args.effects, workers=args.workers, progress=_progress(args))


def _variability(args: Arguments) -> Any:
    from bayes_damper.variability import variability

    return variability(
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
    from bayes_damper.commands.compare import compare

    return compare(args.folders, out=args.out, seed=args.seed)


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
    from bayes_damper.campaign.import_options import columns_of
    from bayes_damper.campaign.importer import import_records, init_campaign, left_over, records_in
    from bayes_damper.commands.check import check

    before = records_in(args.folder)
    if args.table is not None:
        import_records(args.table, args.folder, args.raw, args.overwrite)
        return check(args.folder, left_over(args.folder, before))
    given = {key: value for key, value in vars(args).items() if key in args.options and value is not None}
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
        init_campaign(args.folder, [raw / f for f in args.files], args.overwrite, args.raw, **given)
    except InputError as error:
        if not answers:
            raise
        kept = f"what was answered, to be given again as options: {_as_options(answers)}"
        raise InputError([*error.faults, kept]) from None
    return check(args.folder, left_over(args.folder, before))


def _as_options(answers: Mapping[str, Any]) -> str:
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
        if not text.strip().lstrip("+-").isdigit() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text}: give a whole number, at least {least}")
        return int(text)

    return read


_count, _seed = _at_least(1), _at_least(0)


def _number(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


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


class _OneOrEach(argparse.Action):
    """One value for all channels, or one for each of them."""

    def __call__(self, _parser: Any, namespace: Any, values: Any, _option: Any = None) -> None:
        setattr(namespace, self.dest, values[0] if len(values) == 1 else values)


def _init_options(sub: Any) -> list[str]:
    """An option for every key of the import's tables, and of [rig] and [measurement]; their names."""
    from bayes_damper import campaign
    from bayes_damper.campaign import import_options as tables

    left_out = {"source", "sha256", "file", "trial", "holdout"}
    keys = {k: v for table in (tables.INIT, tables.TRIAL, tables.READER) for k, v in table.items() if k not in left_out}
    known = {"name": "of the campaign (default: that of the folder)", "description": "a sentence",
             "source_text": "where the data come from, licence"}  # fmt: skip
    for key in (*campaign.Rig.__dataclass_fields__, *tables.MEASUREMENT):
        known[key] = campaign.COMMENTS.get(key, "of campaign.toml").replace("%", "%%")
    for key, (types, text) in keys.items():
        flag, about = f"--{key.replace('_', '-')}", text.replace("%", "%%")
        if bool in types:
            sub.add_argument(flag, action=argparse.BooleanOptionalAction, default=None, help=about)
        elif types == (list,):
            sub.add_argument(flag, nargs="+", type=_number, metavar="X", help=about)
        elif list in types:
            sub.add_argument(flag, nargs="+", type=_number, metavar="X", help=about, action=_OneOrEach)
        else:
            kind = str if types == (str,) else _number
            sub.add_argument(flag, type=kind, metavar="X", help=about)
    for key, text in known.items():
        kind = str if key in ("name", "description", "source_text") else _number
        several = {"nargs": "+", "action": _OneOrEach} if "per channel" in text else {}
        sub.add_argument(f"--{key.replace('_', '-')}", type=kind, metavar="X", help=text, **several)
    return [*keys, *known]


def _weighed(args: Arguments) -> dict[str, Any]:
    """What every command that weighs effects takes (`weighing`), and where its files and random numbers come from."""
    names = ("nominal", "effects", "priors", "out", "seed", "workers")
    return {name: getattr(args, name) for name in names}


def _diagnose(args: Arguments) -> Any:
    from bayes_damper.commands.diagnose import diagnose
    from bayes_damper.commands.fleet import diagnose_fleet
    from bayes_damper.runs.progress import make_reporter

    given = _weighed(args) | {"prior_unknown": args.prior_unknown}
    if len(args.campaign) > 1:
        return diagnose_fleet(args.campaign, scheduler=args.scheduler, progress=_progress(args), **given)
    if args.scheduler is not None:
        raise InputError("--scheduler: it spreads several campaigns over a cluster; leave it out for one")
    return diagnose(args.campaign[0], report=make_reporter(quiet=args.quiet or args.json), **given)


def _plan(args: Arguments) -> Any:
    from bayes_damper.commands.plan import plan

    return plan(args.campaign, **_weighed(args))


def _withheld(args: Arguments) -> Any:
    from bayes_damper.validation.withheld import verify, withheld

    if args.verify is not None:
        return verify(args.verify, args.folder)
    return withheld(
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
    from bayes_damper.tuning import tune

    return tune(
        args.folder,
        case=args.case,
        J2=args.secondary_inertia,
        k2t=args.k2t,
        R=args.bar_radius,
        magnet_pull=args.magnet_pull,
        target_db=args.target_db,
        amplitudes=args.torque,
        seed=args.seed,
        effects=args.effects,
        out=args.out,
        report=make_reporter(quiet=args.quiet or args.json),
    )


def _thesis(args: Arguments) -> Any:
    from bayes_damper.thesis import recompute

    return recompute(args.out)


def _bench(args: Arguments) -> Any:
    if args.timed == "diagnose":
        from bayes_damper.commands import bench_parts

        found = bench_parts.diagnose_by_parts(args.campaign)
        bench_parts.save(found, args.out)
        return found
    from bayes_damper.validation.bench import bench, save

    result = bench(repeats=args.repeats, peers=not args.no_peers)
    save(result, args.out)
    return result


def _report(args: Arguments) -> Any:
    from bayes_damper.report import report

    return report(args.folder, out=args.out)


def _command(
    commands: Any, name: str, run: Callable[[Arguments], Any], text: str, *, out: str | None = None
) -> argparse.ArgumentParser:
    """A command with the options that all have."""
    sub: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
    sub.set_defaults(run=run)
    if out is not None:
        sub.add_argument("--out", type=Path, default=Path(out), help=f"folder for the results (default: {out})")
    sub.add_argument("--seed", type=_seed, default=1, metavar="N", help="decides every random number (default: 1)")
    sub.add_argument("--quiet", action="store_true", help="no progress, no summary: only errors")
    sub.add_argument("--json", action="store_true", help="print the result as JSON instead of text")
    about = "what goes to standard error beside progress: files read and written, kernels compiled"
    sub.add_argument("--log-level", choices=LOG_LEVELS, default="warning", help=about)
    return sub


def _own_effects(sub: argparse.ArgumentParser) -> None:
    about = "a folder with effects of your own or learnt laws, or one such file"
    sub.add_argument("--effects", type=Path, metavar="DIR", help=about)


def _weighing(sub: argparse.ArgumentParser) -> None:
    about = "linear: a nominal model without dry friction, which is then a candidate"
    sub.add_argument("--nominal", choices=("nonlinear", "linear"), default="nonlinear", help=about)
    _own_effects(sub)
    sub.add_argument("--priors", type=Path, metavar="F.toml", help="priors of the nominal parameters")
    sub.add_argument("--workers", type=_count, default=2, metavar="N", help="simulations side by side (default: 2)")


def _workers(sub: argparse.ArgumentParser) -> None:
    about = "processes on this machine (default: 2)"
    sub.add_argument("--workers", type=_count, default=2, metavar="N", help=about)
    sub.add_argument("--scheduler", metavar="ADDRESS", help="run on an existing Dask cluster instead")


def _first_steps(command: Adding) -> None:
    """Commands that show the program or look at data."""
    sub = command("demo", _demo, "the main job on the shipped data, start to report", out="results/demo")
    sub.add_argument("--quick", action="store_true", help="a tenth of the draws: for a first look, marked as such")
    _workers(sub)

    command("examples", _examples, "a small campaign to play with: a cart whose spring hides something", out="example")

    sub = command("check", _check, "read and validate a campaign, or name every fault")
    sub.add_argument("campaign", help="folder of the campaign, or `thesis`")

    sub = command("simulate", _simulate, "one noise-free record of the thesis's rig, in the record format")
    sub.add_argument("--case", default="IV", help="thesis case: I, II, III or IV (default: IV)")
    sub.add_argument("--uncoupled", action="store_true", help="the primary inertia alone")
    sub.add_argument("--set", action="append", metavar="NAME=VALUE", help="a parameter, a rig key, or EFFECT.PARAMETER")
    sub.add_argument("--effect", metavar="NAME", help="an effect of the library, at the first of its typical values")
    _own_effects(sub)
    sub.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="sample rate (default: 1000)")
    sub.add_argument("--duration", type=float, default=1.0, metavar="S", help="length of the record (default: 1)")
    sub.add_argument(
        "--inputs", type=Path, metavar="F.csv",
        help="what acts: time_s and any of torque1_n_m, torque2_n_m, ground_rad, motion1_rad, ...; gives the times",
    )  # fmt: skip
    sub.add_argument("--out", type=Path, required=True, metavar="F.csv", help="the record to write")


def _fitting(command: Adding) -> None:
    """Fit, diagnosis and plan."""
    sub = command("fit", _fit, "posterior per case, and of all cases together for a campaign", out="results/fit")
    sub.add_argument("campaign", help="folder of the campaign, or `thesis`")
    sub.add_argument("--case", action="append", metavar="C", help="only this case (repeat for several)")
    sub.add_argument("--priors", type=Path, metavar="F.toml", help="prior file in place of the shipped one")
    sub.add_argument("--normal-force", choices=("linear", "constant"), help="law of the magnet's pull (eq. 20)")
    sub.add_argument("--noise", choices=("auto", "gaussian", "student", "ar"), default="auto",
                     help="white, with outliers, or correlated by what the fit leaves (default: by data)")  # fmt: skip
    sub.add_argument("--effect", metavar="NAME", help="give the model this effect, e.g. the verdict of a diagnosis")
    _own_effects(sub)
    sub.add_argument("--thorough", action="store_true", help="50 autocorrelation times instead of 20")
    sub.add_argument(
        "--most-steps",
        type=_count,
        metavar="N",
        help="at most N steps of each ensemble, not counting the warm-up (or the fewest that can be judged)",
    )
    _workers(sub)

    sub = command("diagnose", _diagnose, "the sim-to-real gap: where it lies, what causes it, how far it shrinks",
                  out="results/diagnose")  # fmt: skip
    sub.add_argument("campaign", nargs="+", help="folder of the campaign, or `thesis`; several: one page for all")
    sub.add_argument("--scheduler", metavar="ADDRESS", help="spread several campaigns over an existing Dask cluster")
    sub.add_argument("--prior-unknown", type=float, default=0.15, metavar="P",
                     help="prior probability that the cause is none of the library's (default 0.15)")  # fmt: skip
    _weighing(sub)

    sub = command("plan", _plan, "before measuring: effects the planned trials could distinguish, and with how many",
                  out="results/plan")  # fmt: skip
    sub.add_argument("campaign", help="folder with campaign.toml and trials.csv; the records need not exist")
    _weighing(sub)


def _figures_and_proofs(command: Adding) -> None:
    """The check on withheld data, designs, the thesis and the bench."""
    sub = command("withheld", _withheld, "the check on data whose effect is withheld: sealed verdicts, then scores",
                  out="results/withheld")  # fmt: skip
    sub.add_argument("folder", nargs="?", type=Path, help="campaigns, one folder each (default: those shipped)")
    sub.add_argument("--full", action="store_true", help="all campaigns, and each again without its effect (hours)")
    sub.add_argument("--key", type=Path, metavar="F.json", help="the key (default: FOLDER_key.json beside the folder)")
    sub.add_argument(
        "--verify",
        type=Path,
        metavar="F.zip",
        help="hold the seals of a finished run's archive again, and those of its campaigns in FOLDER",
    )
    _own_effects(sub)
    _workers(sub)

    sub = command("tune", _tune, "insertion loss and resonance shift of a design, with uncertainty", out="results/tune")
    sub.add_argument("folder", type=Path, help="folder of a fit")
    sub.add_argument("--case", help="which case of the fit (default: the only one, else IV; joint: all together)")
    sub.add_argument("--secondary-inertia", type=float, metavar="J2", help="kg m^2 (kg); default: the rig's own")
    sub.add_argument("--k2t", type=float, help="stiffness of the coupling, N m/rad (N/m); default: as fitted")
    sub.add_argument("--bar-radius", type=float, metavar="R", help="m; scales k2t by R^2 (eq. 21)")
    sub.add_argument("--magnet-pull", type=float, metavar="N0", help="N; default: the rig's own")
    sub.add_argument("--torque", type=float, nargs="+", metavar="T",
                     help="exciting torques, N m (forces, N); default: of the size of the rig")  # fmt: skip
    _own_effects(sub)
    sub.add_argument("--target-db", type=float, default=10.0, metavar="DB", help="loss to reach (default: 10)")

    command("thesis", _thesis, "every table and figure of the thesis recomputed: printed, computed, verdict",
            out="results/thesis")  # fmt: skip

    sub = command("bench", _bench, "speed and accuracy on this machine beside the peers installed", out="results/bench")
    sub.add_argument("--repeats", type=_count, default=7, metavar="N", help="rounds over all rows (default: 7)")
    sub.add_argument("--no-peers", action="store_true", help="time only our own kernels")
    sub.add_argument("--command", dest="timed", choices=["diagnose"], help="where a command spends its time instead")
    sub.add_argument(
        "--campaign", type=Path, metavar="DIR", help="with --command: which campaign (default: a shipped one)"
    )


def _results(command: Adding) -> None:
    """Commands about folders: runs to go on with, campaigns from logger files, results."""
    sub = command("resume", _resume, "go on with an interrupted run; --more extends a finished one")
    sub.add_argument("folder", type=Path, help="the folder that the run writes to")
    sub.add_argument("--more", action="store_true", help="extend a run that has finished")
    about = "the folder with effects of your own that the run began with (no code is taken from results)"
    sub.add_argument("--effects", type=Path, metavar="DIR", help=about)
    sub.add_argument("--workers", type=_count, metavar="N", help="processes on this machine (default: as before)")

    sub = command("init", _init, "a commented campaign from a pile of logger files")
    sub.add_argument("folder", type=Path, help="the campaign to write")
    sub.add_argument("files", nargs="*", type=Path, help="logger files, one trial each")
    sub.add_argument("--table", type=Path, metavar="import.toml", help="an import table in place of files and options")
    sub.add_argument("--raw", type=Path, metavar="DIR", help="where the logger files lie")
    sub.add_argument(
        "--overwrite",
        action="store_true",
        help="replace the campaign that the folder holds; records that the new one does not name stay, with a warning",
    )
    sub.set_defaults(options=_init_options(sub))

    sub = command("variability", _variability, "what the cases of a fit share and where they differ")
    sub.add_argument("folder", help="results of `fit`, or `thesis`")
    sub.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default: the folder itself)")
    sub.add_argument("--particles", type=_count, default=288, metavar="N", help="particles of each run (default: 288)")
    sub.add_argument("--repeats", type=_count, default=2, metavar="N", help="runs of each model (default: 2)")
    sub.add_argument("--unseen", action=argparse.BooleanOptionalAction, default=True,
                     help="other priors, another law of friction, each case left out (published features)")  # fmt: skip
    sub.add_argument("--adapt", action=argparse.BooleanOptionalAction, default=True,
                     help="more particles, up to 1024, where repeated runs differ (published features)")  # fmt: skip
    _workers(sub)

    sub = command("compare", _compare, "results side by side")
    sub.add_argument("folders", nargs="+", metavar="FOLDER", help="folders that other commands have written to")
    sub.add_argument("--out", type=Path, metavar="DIR", help="write comparison.json and a figure there too")

    sub = command("report", _report, "one self-contained HTML page from whatever results the folder holds")
    sub.add_argument("folder", type=Path, help="a folder that other commands have written to")
    sub.add_argument("--out", type=Path, metavar="F.html", help="the page (default: report.html in the folder)")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="bayes-damper",
        description="Calibrate a magnetically coupled mass damper against measurements, with honest uncertainty, and "
        "find out where and why the model and the rig differ.",
        epilog="Exit codes: 0 done, 2 bad input, 3 did not converge (results written and marked), 4 a self-check "
        "failed, 130 interrupted (state saved).",
    )
    parser.add_argument("--version", action="version", version=_version())
    parser.add_argument(
        "--print-completion",
        action=_Completion,
        choices=("bash", "zsh", "tcsh"),
        help="print what makes that shell complete commands and options with the Tab key",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    for add in (_first_steps, _fitting, _figures_and_proofs, _results):
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
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    if rest:  # files behind the options
        args.files += map(Path, rest)
    _log_from(args.log_level)
    LOG.info("bayes_damper %s, %s, seed %s", _version(), args.command, args.seed)
    try:
        with seldom_collected(), _closed_afterwards(args):
            result = args.run(args)
    except BayesDamperError as error:
        print(f"bayes-damper {args.command}: {error}", file=sys.stderr)
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
        print(f"bayes-damper {args.command}: stopped", file=sys.stderr)
        return int(ExitCode.INTERRUPTED)
    if not args.quiet:
        from bayes_damper.runs.json_files import json_text

        print(json_text(result.to_json()) if args.json else printable(result.text()))
    return int(result.exit_code)


if __name__ == "__main__":
    sys.exit(main())
