"""The pages of docs/proof/: numbers of finished parts in, Markdown, JSON and figures out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import parts
import ranks
from matplotlib.figure import Figure

from bayes_damper import figures
from bayes_damper.text import counted, p_value

Results = Sequence[Mapping[str, Any]]


def collected(results: Results) -> dict[str, list[int]]:
    """Ranks of each quantity over the campaigns."""
    names = dict.fromkeys(name for result in results for name in result["ranks"])
    return {name: [r["ranks"][name] for r in results if name in r["ranks"]] for name in names}


def calibration(found: Mapping[str, Results], settings: Mapping[str, Any]) -> None:
    """Page of the calibration: `found` maps each kind of campaign to what is finished of it."""
    lines = [
        "Simulation-based calibration: truths drawn from the prior, records simulated from them and fitted; the rank",
        f"of each truth among {ranks.DRAWS} nearly independent draws of its posterior must be uniform (Talts et al.",
        "2018, arXiv:1804.06788). The band holds the whole cumulative distribution of one quantity with 95 %",
        "(Säilynoja, Bürkner and Vehtari 2022, Statistics and Computing 32:32); p is the probability that uniform",
        "ranks stray as far. One quantity in twenty leaves its band by chance, so a kind passes if the least p of all",
        "its quantities is not too small for so many (Šidák). `log_likelihood` is that of the readings at the draw,",
        "written out in the proof itself: it notices what no single parameter shows, such as data that the fit",
        "does not use (Modrák et al. 2023, arXiv:2211.02383).",
        "",
        "The fit as it is gives little weight to the release and to readings beside a reversal of friction, because no",
        "real rig follows the formulas there to the microsecond. Synthetic campaigns do: to them this is information",
        "left unused on purpose, so posteriors are a little wide there and their draws fit those readings a little",
        "worse than the truth does. Of the fit as it is every parameter must be calibrated; of the fit without this",
        "allowance, whose likelihood is exactly that of the campaigns, the log likelihood too.",
        "",
        "What to expect of the former: with residuals linear in the unknowns, derivatives J and weights W <= 1 of the",
        "squared residuals, the fit's covariance is (1 + J'WJ)^-1, but its estimates scatter about the truth by",
        "(1 + J'WJ)^-1 (1 + J'W^2 J) (1 + J'WJ)^-1, which is smaller. So intervals are as wide as they need to be or",
        "wider, and the truth fits the readings better than draws do: its log likelihood has a mean rank above 0.5.",
        "",
        "Made by `make prove`, resumable; campaigns are short and of few trials so that hundreds can be fitted:",
        "",
        *(f"- {key}: {value}" for key, value in settings.items()),
        "",
    ]
    numbers: dict[str, Any] = {"settings": dict(settings), "kinds": {}}
    for kind, results in found.items():
        quantities = collected(results)
        n = len(results)
        table = {name: _row(values) for name, values in quantities.items()}
        judged = [name for name in table if name != "log_likelihood" or "as it is" not in kind]
        least = ranks.least_of([table[name]["p"] for name in judged])
        inside = sum(row["p"] > 0.05 for row in table.values())
        lines += [
            f"## {kind}: {n} campaigns",
            "",
            f"{inside} of {len(table)} quantities inside their own 95 % band; "
            + ("all together" if len(judged) == len(table) else "all parameters together")
            + f": p = {least:.3g}",
            f"({'passed' if least > 0.05 else '**not passed**'}). Effective draws: median",
            f"{np.median([r['ess'] for r in results]):.0f}, least {min(r['ess'] for r in results)};",
            f"CPU time {np.mean([r['cpu_seconds'] for r in results]):.1f} s a campaign.",
        ]
        rows = []
        for name, row in table.items():
            held = [
                f"{c['rate']:.1%} ({c['interval'][0]:.1%} to {c['interval'][1]:.1%})" for c in (row["50"], row["90"])
            ]
            flag = "" if row["p"] > 0.05 else " **outside**"
            rows.append((name, f"{row['p']:.3f}{flag}", f"{row['mean']:.3f}", *held))
        columns = ("quantity", "p", "mean rank", "truth in the 50 % interval", "truth in the 90 % interval")
        lines += [*_table(columns, rows), ""]
        numbers["kinds"][kind] = {"campaigns": n, "inside": inside, "p_of_all": least, "quantities": table}
    numbers["commits"] = {r["commit"] for results in found.values() for r in results}
    passed = [kind for kind, entry in numbers["kinds"].items() if entry["p_of_all"] > 0.05]
    verdict = (
        f"{sum(len(results) for results in found.values())} campaigns of {len(numbers['kinds'])} kinds; all quantities "
        f"together inside their band for {len(passed)} of them"
        + "".join(
            f"; not for {kind}, p = {e['p_of_all']:.2g}" for kind, e in numbers["kinds"].items() if kind not in passed
        )
        + "."
    )
    parts.write_page("calibration", verdict, lines, numbers, _ecdf_figure(found))


def _row(values: Sequence[int]) -> dict[str, Any]:
    n = len(values)
    row: dict[str, Any] = {"n": n, "p": ranks.p_value(values), "mean": float(np.mean(values)) / ranks.DRAWS}
    for share in (50, 90):
        hits, low, high = ranks.coverage(values, share / 100.0)
        row[str(share)] = {"rate": hits / n, "interval": [low, high]}
    return row


def _ecdf_figure(found: Mapping[str, Results]) -> Figure:
    """Cumulative distribution of the ranks minus the uniform one, each kind with its band."""
    rows = int(np.ceil(len(found) / 2))
    figure = figures.new_figure(7.0, 2.6 * rows)
    x = np.arange(1, ranks.DRAWS + 1) / (ranks.DRAWS + 1)
    for k, (kind, results) in enumerate(found.items()):
        axis = figure.add_subplot(rows, 2, k + 1)
        n = len(results)
        low, high = ranks.band(n)
        axis.fill_between(x, low / n - x, high / n - x, color="#dddddd", step="mid", label="95 % band")
        for name, values in collected(results).items():
            strong = name == "log_likelihood"
            axis.plot(
                *(x, ranks.counts(values) / len(values) - x),
                color=figures.COLOURS[1] if strong else figures.COLOURS[0],
                lw=1.4 if strong else 0.5,
                alpha=1.0 if strong else 0.6,
                ls="--" if strong else "-",
                label="log likelihood" if strong else "_",
            )
        axis.set_title(f"{kind}: {n} campaigns")
        axis.set_xlabel("rank / (draws + 1)")
        axis.set_ylabel("cumulated share minus uniform")
        if k == 0:
            axis.legend(loc="upper right")
    return figure


def bugs(found: Sequence[Mapping[str, Any]], level: float) -> None:
    """Page of the planted bugs: what `hunt` gave for each."""
    lines = [
        "Each bug is planted in the fit alone, never in the simulated campaigns, and the calibration of",
        "[its own page](calibration.md) must notice: campaigns are added until the ranks of all quantities",
        f"together are less likely than {level:g} under uniformity. The sound fit is watched by the same rule",
        "and must not raise it. Kinds of campaigns: lone, an uncoupled and a coupled trial; repeats, two coupled",
        "trials; faint, as lone under 20 times the noise, where priors decide much, so that their densities are ranked",
        "too, that of the rig's parameters and that of each trial's own angle and friction (a prior much too wide",
        "shows there alone: the posterior under it is as uniform in the parameter itself as one without a prior).",
        "Of the draws from a record's posterior one in fifty is a snooker move's, and what it does wrong is undone at",
        "once (on normal densities of 9 to 28 unknowns it moved the mean log density by 0.01 to 0.05 of its spread),",
        "so it is looked for in a sampler that has learnt no proposals yet, of whose moves it is one in five; a sound",
        "sampler of that kind is watched too.",
        "The log likelihood of a sound fit is not quite uniform (its page says why), so that what it alone gives away,",
        "and only after dozens of campaigns, is caught less surely than what another quantity gives away.",
    ]
    rows = []
    for row in found:
        after = f"not caught by {row['campaigns']}" if row["caught"] is None else str(row["caught"])
        told = ", ".join(c[:7] for c in row["commits"])
        rows.append((row["bug"], row["kind"], after, row["by"], f"{row['p']:.1e}", told))
    lines += _table(("bug", "campaigns", "caught after", "by", "p", "commit"), rows)
    planted = [row for row in found if not row["bug"].startswith("none")]
    caught = sum(row["caught"] is not None for row in planted)
    verdict = f"{caught} of {len(planted)} planted bugs caught."
    commits = {c for row in found for c in row["commits"]}
    parts.write_page("bugs", verdict, lines, {"level": level, "bugs": list(found), "commits": commits})


def kills() -> None:
    """Page of the kills: what is finished of both parts."""
    titles = {
        "kills": "A fit of four trials, gone on with by `resume`; compared are posterior.nc (every variable), "
        "summary.json (but for times and provenance), summary.csv and all figures",
        "kills-sampler": "The sampler by itself, saving its state ten times a second; compared are all its draws",
    }
    lines = [
        "A run is stopped by SIGKILL at a random moment, gone on with, killed again, up to ten times, until it ends;",
        "what it ends with is compared bit for bit with a run that nothing disturbed. Moments are drawn evenly over a",
        "third of the time that a whole run takes, from each start on: what is resumed takes up late.",
    ]
    rows: list[tuple[str, ...]] = []
    verdicts: list[str] = []
    numbers: dict[str, Any] = {}
    commits: set[str] = set()
    for name, title in titles.items():
        results = list(parts.finished(name).values())
        if not results:
            rows.append((title, "not run yet", "", "", ""))
            continue
        total, same = sum(len(r["kills"]) for r in results), sum(not r["different"] for r in results)
        after = Counter(name for r in results for name in r.get("after", ()))
        told = ", ".join(f"{name} {count}" for name, count in after.most_common())
        rows.append((title, str(total), str(len(results)), str(same), told))
        verdicts.append(
            f"{'fit' if name == 'kills' else 'sampler'}: {total} kills, {same} of {len(results)} runs the same"
        )
        numbers[name] = {"kills": total, "runs": len(results), "same": same, "lives": results}
        commits |= {r["commit"] for r in results}
    numbers["commits"] = commits
    lines += _table(("what", "kills", "runs", "the same, bit for bit", "last file written before a kill"), rows)
    parts.write_page("kills", "; ".join(verdicts) + ".", lines, numbers)


def damage() -> None:
    """Page of the damaged files: what is finished of all parts."""
    results = [r for name in ("files", "results", "lines") for r in parts.finished(f"damage-{name}").values()]
    made = [*parts.finished("damage-purpose").values()]
    total = sum(r["inputs"] for r in results)
    ways = sum(r["told"] + sum(r["silent"].values()) + len(r["faults"]) for r in made)
    faults = [case for r in (*results, *made) for case in r["faults"]]
    peak = max(r["peak_kb"] for r in (*results, *made)) / 1e6
    lines = [
        "Good files of a campaign, an import, loggers and a results folder are changed at random, one to four times",
        "each, and read by the command that reads them; so are command lines of `init`. Each must end with a sentence",
        "and exit code 2, or go on where what is left can be read: nobody can see that a digit changed, or",
        "that two rows were swapped. A fault is a traceback, a call that does not end within a minute, an empty",
        "sentence, or one with control characters.",
        f"Memory must stay below 1 GB (most here: {peak:.2f} GB).",
    ]
    numbers: dict[str, Any] = {"inputs": total, "on_purpose": ways, "faults": len(faults), "peak_gb": peak}
    for title, key in (("file", "files"), ("change, alone or beside others", "changes")):
        counts: Counter[str] = Counter()
        for r in results:
            counts.update(r[key])
        hows = ("sentence", "silence", "fault")
        rows = {
            name: [counts[f"{name}|{how}"] for how in hows] for name in sorted({c.partition("|")[0] for c in counts})
        }
        lines += _table(
            (title, "inputs", "a sentence", "silence", "faults"),
            [(name, str(sum(row)), *map(str, row)) for name, row in rows.items()],
        )
        numbers[key] = {name: dict(zip(hows, row, strict=True)) for name, row in rows.items()}
    lines += [
        "",
        "Changes made on purpose, each kind at each place of each file; the quick tests try some of them:",
        "",
    ]
    numbers["purpose"] = {
        r["name"]: {"sentence": r["told"], "silence": sum(r["silent"].values()), "fault": len(r["faults"])}
        for r in made
    }
    lines += _table(
        ("read by", "ways", "a sentence", "silence", "faults"),
        [(name, str(sum(row.values())), *map(str, row.values())) for name, row in numbers["purpose"].items()],
    )
    reasons: Counter[str] = Counter()
    for r in made:
        reasons.update(r["silent"])
    lines += _table(("why silence is right", "ways"), [(why, str(n)) for why, n in reasons.most_common()])
    numbers["reasons"] = dict(reasons.most_common())
    numbers["commits"] = {r["commit"] for r in (*results, *made)}
    if total < 100_000:  # where the machine was needed for something else
        lines += ["", "Of an earlier run, on 2026-11-24 at commit c7ac637f994a: 110 000 random inputs, 0 faults."]
    lines += ["", *(f"- {case}" for case in faults[:20])] if faults else []
    said = [f"{n:,}".replace(",", " ") for n in (total, ways)]
    verdict = f"{said[0]} random inputs, {said[1]} on purpose, {len(faults)} faults."
    parts.write_page("damage", verdict, lines, numbers)


def integrator(rows: Results) -> None:
    """Page of the integrator's accuracy over the prior."""
    lines = [
        "Accelerations of both bodies over 1 s at 1 kHz, parameters drawn over the whole prior box (nu from 5 to 3000",
        "s/rad), against the tests' own Runge-Kutta solver: the C library's tanh, steps that keep step times slope",
        "below 0.05, nothing shared with the package, and itself held against scipy's DOP853 at a tolerance of 1e-12.",
        *_table(
            ("pull", "vectors", "largest error, share of the peak", "the same at tolerance 0.1"),
            [(r["law"], str(r["vectors"]), f"{r['error']:.1e}", f"{r['tight']:.1e}") for r in rows],
        ),
        "",
        "Bounds: 1e-4 and 1e-5.",
    ]
    worst, tight = (max(r[key] for r in rows) for key in ("error", "tight"))
    verdict = (
        f"Largest error over {sum(r['vectors'] for r in rows)} vectors: {worst:.1e} of the peak, {tight:.1e} tight."
    )
    parts.write_page("integrator", verdict, lines, {"laws": list(rows)})


def samplers(result: Mapping[str, Any]) -> None:
    """Page of the samplers beside their peers."""
    lines = [
        "One coupled record of 1 s at 1 kHz, nu = 100 s/rad, 9 unknowns, the release angle integrated out; all",
        "samplers see the same log density from the same start. PINTS and zeus call our own posterior; NUTS needs",
        "derivatives and has the density in JAX"
        + ("." if result["jax_gap"] is None else f" (largest difference {result['jax_gap']:.2g} nats)."),
        "Draws are effective ones of the worst coordinate after warm-up; CPU time on one core, all in one run; means:",
        "largest difference from ours over its Monte-Carlo error; sds: largest ratio.",
    ]
    columns = ("sampler", "draws", "R-hat", "evaluations each", "warm-up, s", "draws, s", "each s", "ours over it",
               "means", "sds")  # fmt: skip
    rows = [
        (
            r["name"], f"{r['ess']:.0f}", "-" if r["r_hat"] is None else f"{r['r_hat']:.4f}",
            f"{r['evaluations_each']:.1f}", f"{r['warm_up']:.2f}", f"{r['seconds']:.2f}", f"{r['rate']:.0f}",
            f"{r['ratio']:.1f}", f"{r['means']:.1f}", f"{r['sds']:.2f}",
        )
        for r in result["runs"]
    ]  # fmt: skip
    lines += _table(columns, rows)
    stages = result.get("stages")
    if stages:
        lines += [
            "",
            f"Ours from the record to the rule met: {stages['all']:.1f} s of CPU time (fit {stages['fit']:.1f},",
            f"warm-up {stages['warm-up']:.1f}, draws {stages['draws']:.1f}); promised: 6 s.",
        ]
    lines += ["", f"Not run: {', '.join(result['missing'])}."] if result["missing"] else []
    told = ", ".join(f"{r['ratio']:.1f} ({r['name']})" for r in result["runs"][1:])
    loose = [r["name"] for r in result["runs"] if r["r_hat"] is not None and r["r_hat"] >= 1.05]
    lines += ["", f"R-hat above 1.05, so its posterior is not compared: {', '.join(loose)}."] if loose else []
    verdict = f"Effective draws per second, ours over theirs: {told}. Posteriors agree."
    if not result["agree"]:
        verdict = verdict.replace("Posteriors agree.", "Posteriors do not agree.")
    minutes = sum(r["warm_up"] + r["seconds"] for r in result["runs"]) / 60.0
    parts.write_page("samplers", verdict, lines, dict(result), minutes=minutes)


RIG_UNITS = {
    "rotary_pendulum": ("degrees", 57.29578), "tuned_mass_damper": ("mm", 1e3), "double_pendulum": ("mrad", 1e3),
    "single_pendulum": ("mrad", 1e3), "servo_drop": ("mrad", 1e3),
}  # fmt: skip
"""Unit that each rig's readings are told in, and how many of it make one of the readings' own."""
REFERENCE = {
    ("rotary_pendulum", 1): 0.60, ("rotary_pendulum", 2): 1.14, ("rotary_pendulum", 3): 0.28,
    ("tuned_mass_damper", 2): 1.8, ("single_pendulum", 2): 11.8, ("single_pendulum", 1): 2.1,
    ("double_pendulum", 2): 1.09, ("double_pendulum", 3): 3.1, ("double_pendulum", 4): 30.5,
}  # fmt: skip
"""What reference fits with dry friction miss on held-out trials, in those units; state from the whole trial.

Those of the single pendulum have quadratic drag too.
"""


def rigs(found: Results) -> None:
    """Page of the measured rigs: the verdicts, the forecasts with the coverage of their bands, and the peers."""
    columns = ("rig", "verdict", "other answers above 5 %", "gap on held-out trials", "credible set")
    lines = [
        "`diagnose --nominal linear` of five [measured rigs](../rigs/index.md): the nominal model has viscous",
        "damping only. Every held-out trial is forecast from the state in its first two periods; the error is the",
        "root mean square over the rest. Calibrated bands contain 50 and 90 % of the readings. The column `whole",
        "trial` has the error if the state is inferred from the whole held-out trial. The reference fits with dry",
        "friction, of the single pendulum with quadratic drag too (least squares by others, on the same stretches),",
        "are quoted for that.",
        *_table(columns, [_verdict_cells(row) for row in found]),
    ]
    columns = (
        "rig, held-out trial", "n", "unit", "error, before / after", "50 % band", "90 % band", "whole trial",
        "reference",
    )  # fmt: skip
    lines += _table(columns, [cells for row in found for cells in _forecast_cells(row)])
    for row in found:
        for d in row["others"]:
            number = d["forecast"]["trials"][0]["trial"]
            lines += ["", f"With trial {number} of {row['rig']} held out the verdict is {_ranked(d['probabilities'])}."]
    columns = (
        "rig", "tool, model", "residual, fitted trials", "error, held out", "readings in 50, 90 % bands",
        "result on the gap",
    )  # fmt: skip
    lines += [
        "",
        "## Other tools on the same data",
        "",
        "scipy, lmfit and PINTS use the simulation of this package, so that only the inference differs, and start at",
        "its fit. pysindy regresses smoothed accelerations on a list of terms and keeps those with the best value of",
        "Schwarz's criterion (BIC). Their bands include the spread of the parameters, and white noise of the size of",
        "their residuals; the criterion assumes the same noise, whatever its correlation.",
        *_table(columns, [_peer_cells(row, peer) for row in found for peer in row["peers"]]),
    ]
    columns = (
        "rig, held-out trial", "unit", "viscous: first periods / whole", "with dry friction: first periods / whole",
    )  # fmt: skip
    lines += [
        "",
        "Least squares without any prior: the smallest error that the equations allow, whatever the inference. The",
        "state of each held-out trial is inferred from its first two periods, or from the whole trial.",
        *_table(columns, [cells for row in found for cells in _least_squares_cells(row)]),
    ]
    named = "; ".join(
        f"{row['rig'].replace('_', ' ')}: {' and '.join(d['pair']['effects']) if d['pair'] else d['verdict']}"
        for row, d in ((row, row["diagnosis"]) for row in found)
    )
    lines += ["", "A tool without a row was not run on that rig."]
    numbers = {"rigs": list(found), "commits": sorted({row["commit"] for row in found})}
    minutes = sum(row["cpu_seconds"] for row in found) / 60.0
    parts.write_page("rigs", f"{named[0].upper()}{named[1:]}.", lines, numbers, minutes=minutes)


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table in Markdown, an empty line above it."""
    marked = [f"| {' | '.join(cells)} |" for cells in (columns, ["---"] * len(columns), *rows)]
    return ["", *marked]


def _verdict_cells(row: Mapping[str, Any]) -> list[str]:
    """What the diagnosis says of a rig."""
    d = row["diagnosis"]
    verdict = f"{d['verdict']} {d['probabilities'][d['verdict']]:.2f}"
    if d["pair"]:
        verdict = f"{' and '.join(d['pair']['effects'])} together {d['pair']['probability']:.2f}"
    others = _ranked({name: p for name, p in d["probabilities"].items() if name != d["verdict"]})
    gap = f"{d['gap']['answer']} ({p_value(d['gap']['p_value'])})"
    return [row["rig"], verdict, others, gap, counted(len(d["credible_set"]), "answer")]


def _forecast_cells(row: Mapping[str, Any]) -> list[list[str]]:
    """Each held-out trial of a rig: what is missed, and what share of the readings the bands hold."""
    unit, times = RIG_UNITS[row["rig"]]
    trials = [t for d in (row["diagnosis"], *row["others"]) for t in d["forecast"]["trials"]]
    out = []
    for t in sorted(trials, key=lambda t: int(t["trial"])):
        sides = [t[side] for side in ("before", "after") if side in t]  # nothing is added where the answer is none
        held = [" / ".join(f"{100 * s[f'coverage{c}']:.0f} %" for s in sides) for c in (50, 90)]
        ahead, whole = (" / ".join(f"{s[key] * times:.3g}" for s in sides) for key in ("rms", "rms_whole"))
        name, reference = f"{row['rig']}, trial {t['trial']}", REFERENCE.get((row["rig"], int(t["trial"])), "-")
        out.append([name, str(t["readings"]), unit, ahead, *held, whole, str(reference)])
    return out


def _peer_cells(row: Mapping[str, Any], peer: str) -> list[str]:
    """What a peer leaves, misses and says on a rig."""
    unit, times = RIG_UNITS[row["rig"]]
    says = row["peers"][peer]
    ahead = says["forecast"]
    miss = "diverges" if ahead.get("rms") is None else f"{ahead['rms'] * times:.3g} {unit}"
    held = "none"
    if "coverage50" in ahead:
        held = f"{100 * ahead['coverage50']:.0f} and {100 * ahead['coverage90']:.0f} %"
    left = f"{says['rms'] * times:.3g} {unit}" if "rms" in says else "-"
    return [row["rig"], peer, left, miss, held, _says(peer, row["peers"])]


def _least_squares_cells(row: Mapping[str, Any]) -> list[list[str]]:
    """Each held-out trial of a rig under both models of plain least squares."""
    unit, times = RIG_UNITS[row["rig"]]
    viscous, dry = (row["peers"][f"scipy, {model}"]["forecast"]["trials"] for model in ("viscous", "dry"))
    return [
        [
            f"{row['rig']}, trial {first['number']}",
            unit,
            *(f"{t['rms'] * times:.3g} / {t['rms_whole'] * times:.3g}" for t in (first, dry[label])),
        ]
        for label, first in viscous.items()
    ]


def _ranked(probabilities: Mapping[str, float]) -> str:
    """Answers above 5 %, the likeliest first."""
    ranked = sorted(probabilities.items(), key=lambda item: -item[1])
    return ", ".join(f"{name} {p:.2f}" for name, p in ranked if p > 0.05)


def _says(peer: str, peers: Mapping[str, Any]) -> str:
    """What a peer's own numbers say of the gap, in words."""
    says = peers[peer]
    if "kept" in says:
        told = "; ".join(f"equation {i + 1} keeps {', '.join(kept)}" for i, kept in enumerate(says["kept"]))
        return told.replace("|", "\\|")
    if "rho" in says:
        loose = "" if says["r_hat"] < 1.05 else f", not converged (R-hat {says['r_hat']:.1f})"
        return f"nothing; lag-one correlation of the residuals {says['rho']:.2f}{loose}"
    if peer.endswith("dry"):
        gain = peers[peer.replace("dry", "viscous")]["bic"] - says["bic"]
        return f"dry friction {'lowers' if gain > 0.0 else 'raises'} its criterion (BIC) by {abs(gain):.0f}"
    return "nothing by itself"
