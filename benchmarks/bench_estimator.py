"""What does the adaptive law lose when nobody tells it M and l, and it has to estimate them?

Run: python benchmarks/bench_estimator.py [--seeds 8] [--only cases tracking start pulse rest rig]

The loop in MuJoCo as deployed at 1 kHz on the paper's scenarios, the law told M and l by the
estimator and fed its filtered state, unless a line says otherwise. Laws that are told the truth, or
the nominal plant, get the true state. Errors are of ln M and ln l.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from estimated_loop import DT, FILTERED, MEASURED, NOMINAL, TRUE, Array, Rig, Run, run

import afl_mujoco as afl
from afl_mujoco.scenario.scenario import Scenario

IDEAL, FINE = Rig(), Rig(noise=(1e-4, 1e-4))
USUAL = Rig(noise=(1e-4, 5e-4))
COARSE = Rig(noise=(1e-4, 1e-3))
ENCODERS = Rig(step=(3.5e-4, 2.0 * np.pi / 3600.0))
RIGS = {"no noise": IDEAL, "fine": FINE, "usual": USUAL, "coarse": COARSE, "encoders": ENCODERS}
CASES = ("step-step", "step-trapezoid", "trapezoid-step", "trapezoid-trapezoid")
WITHIN = 0.1  # as near to the truth as counts as found


def ensemble(scenario: Scenario, rig: Rig, seeds: int, **options: object) -> list[Run]:
    """The same run under several noises; once where there is none."""
    count = seeds if any(rig.noise) else 1
    return [run(scenario, rig, seed=seed, **options) for seed in range(count)]  # type: ignore[arg-type]


def rms(runs: Sequence[Run], first: float, last: float) -> Array:
    """Root mean square of both errors over a stretch of time."""
    part = slice(round(first / DT), round(last / DT))
    return np.asarray(np.sqrt(np.mean([np.mean(r.error[part] ** 2, axis=0) for r in runs], axis=0)))


def found_after(error: Array, start: float, end: float) -> float:
    """How long after `start` [s] an error is within bounds for good, up to `end`; NaN for never."""
    part = error[round(start / DT) : round(end / DT)]
    outside = np.flatnonzero(np.abs(part) > WITHIN)
    if not len(outside):
        return 0.0
    return float((outside[-1] + 1) * DT) if outside[-1] + 1 < len(part) else float("nan")


def cases(seeds: int) -> None:
    print(
        "\n(T1) objective (O1) less its force term / largest force [N], and how many runs survived"
    )
    lines = {
        "told M, l (adaptive)": dict(told=TRUE, fed=0),
        "told M, l (fixed gains)": dict(told=TRUE, fed=0, gains="fixed"),
        "nominal belief (adaptive)": dict(told=NOMINAL, fed=0),
        "nominal belief (fixed gains)": dict(told=NOMINAL, fed=0, gains="fixed"),
    }
    for name, scenario in afl.SCENARIOS.items():
        print(f"  {name}")
        for label, options in lines.items():
            show_case(label, [run(scenario, IDEAL, **options)])  # type: ignore[arg-type]
        for label, rig in RIGS.items():
            show_case(f"estimated, {label}", ensemble(scenario, rig, seeds))


def show_case(label: str, runs: Sequence[Run]) -> None:
    terms = np.mean([r.terms for r in runs if r.survived], axis=0)
    force = max(float(np.abs(r.force).max()) for r in runs)
    alive = sum(r.survived for r in runs)
    print(f"    {label:<30} {terms[:2].sum():6.3f}   {force:6.1f}   {alive}/{len(runs)}")


def tracking(seeds: int) -> None:
    print("\n(T2) rms of ln M / ln l, and time [ms] from a step until within 10 % for good")
    print(f"  {'':<42} 0.05-1 s       1-6 s     M at 1, 3 s      l at 1, 3 s")
    for label, rig in RIGS.items():
        for case in CASES:
            runs = ensemble(afl.SCENARIOS[case], rig, seeds)
            early, late = rms(runs, 0.05, 1.0), rms(runs, 1.0, 6.0)
            shapes, texts = case.split("-"), []
            for i in range(2):
                spans = ((1.0, 3.0), (3.0, 6.0))
                times = [[found_after(r.error[:, i], *s) for r in runs] for s in spans]
                worst = [f"{1e3 * np.median(t):4.0f}" for t in times]
                texts.append(", ".join(worst) if shapes[i] == "step" else "         -")
            print(
                f"  {label:<10} {case:<30} {early[0]:5.3f}/{early[1]:5.3f}"
                f"  {late[0]:5.3f}/{late[1]:5.3f}"
                f"   {texts[0]:>11}     {texts[1]:>11}"
            )
    print("\n(T3) lag [ms] on the ramps from 0 to 2 s: mean of (truth - estimate) / rate, 0.2-2 s")
    for label, rig in RIGS.items():
        runs = ensemble(afl.SCENARIOS["trapezoid-trapezoid"], rig, seeds)
        part, rates = slice(200, 2000), np.array([0.75, 0.4])
        lags = np.mean([np.mean((r.truth - r.found[1:])[part], axis=0) / rates for r in runs], 0)
        print(f"  {label:<10} M {1e3 * lags[0]:5.0f}   l {1e3 * lags[1]:5.0f}")


def box(end: float) -> list[Scenario]:
    plants = [(m, x) for m in (0.1, 0.2, 0.5, 1.0, 1.5, 2.0) for x in (0.05, 0.1, 0.2, 0.4, 0.7, 1)]
    return [
        afl.Scenario(
            name=f"{m}-{x}", cart_mass=afl.constant(m), half_length=afl.constant(x), duration=end
        )
        for m, x in plants
    ]


def start(seeds: int) -> None:
    print(
        "\n(T4) the start, by the initial belief: nine scenarios and 36 constant plants of the box"
    )
    print("  survived 3 s; largest force, and its ratio to that of the told law, worst plant")
    print("  rms of ln M / ln l over the plants after 5, 10, 20, 50, 100, 300 ms")
    beliefs = {
        "light": (0.1, 0.5),
        "first truth": (0.5, 0.2),
        "nominal": (1.0, 0.5),
        "heavy": (2, 1),
    }
    for hold in (1, 5, 10):
        plants = box(3.0)
        told = [run(s, Rig(hold=hold), told=TRUE, fed=0) for s in plants]
        print(f"  control period {hold} ms; told law survives {sum(r.survived for r in told)}/36")
        for label, (mass, length) in beliefs.items():
            rig = Rig(noise=USUAL.noise, hold=hold)
            settings = rig.settings(initial_cart_mass=mass, initial_half_length=length)
            nine = [run(s, rig, settings=settings) for s in afl.SCENARIOS.values()]
            runs = [run(s, rig, settings=settings) for s in plants]
            pairs = [(r, t) for r, t in zip(runs, told, strict=True) if r.survived]
            ratio = max(np.abs(r.force).max() / np.abs(t.force).max() for r, t in pairs)
            force = max(float(np.abs(r.force).max()) for r in nine)
            errors = [r.error[[5, 10, 20, 50, 100, 300]] for r, _ in pairs]
            text = "  ".join(f"{m:.2f}/{x:.2f}" for m, x in np.sqrt(np.mean(np.square(errors), 0)))
            print(
                f"    {label:<12} {sum(r.survived for r in nine)}/9 (largest {force:5.0f} N)  "
                f"{len(pairs)}/36 (ratio {ratio:5.1f})   {text}"
            )


def pulse(seeds: int) -> None:
    print(
        "\n(T5) pulse of -10 N at 10 s: rms of ln M / ln l before, during, after, in the last 5 s"
    )
    spans = ((9.0, 10.0), (10.0, 10.1), (10.1, 10.3), (10.3, 11.0), (15.0, 20.0))
    for label, rig in (("no noise", IDEAL), ("usual", USUAL)):
        for case in CASES:
            runs = ensemble(afl.SCENARIOS[f"{case}-impulse"], rig, seeds)
            text = "  ".join("{:.2f}/{:.2f}".format(*rms(runs, *span)) for span in spans)
            after = np.mean([np.abs(r.state[10_000:, :2]).max(axis=0) for r in runs], axis=0)
            told = run(afl.SCENARIOS[f"{case}-impulse"], IDEAL, told=TRUE, fed=0)
            was = np.abs(told.state[10_000:, :2]).max(axis=0)
            print(
                f"  {label:<10} {case:<22} {text}   peaks {after[0]:.3f} m, {after[1]:.3f} rad"
                f" (told: {was[0]:.3f}, {was[1]:.3f})"
            )


def rest(seeds: int) -> None:
    print("\n(T6) constant plants, usual noise: error of ln M / ln l at 4 s, 8 s and 20 s,")
    print("  mean over the seeds, and at 20 s its standard deviation")
    plants = [(m, x) for m in (0.1, 0.5, 2.0) for x in (0.05, 0.2, 1.0)]
    never = {"least_cart_acceleration": 1e-9, "least_pole_acceleration": 1e-9}
    for name, changes in (("as chosen", {}), ("never frozen", never)):
        print(f"  {name}")
        for mass, length in plants:
            scenario = afl.Scenario(
                name="rest", cart_mass=afl.constant(mass), half_length=afl.constant(length)
            )
            runs = ensemble(scenario, USUAL, seeds, settings=USUAL.settings(**changes))
            errors = np.array([r.error[[4000, 8000, -1]] for r in runs])
            means = "   ".join(f"{m:+.2f}/{x:+.2f}" for m, x in errors.mean(axis=0))
            spread = "{:.2f}/{:.2f}".format(*errors[:, -1].std(axis=0))
            print(f"    M {mass:3g} kg, l {length:4g} m   {means}   +- {spread}")


def rig(seeds: int) -> None:
    print("\n(T7) what else a rig has: mean over the four cases, usual noise")
    print(
        "  survived; objective less its force term; rms of ln M / ln l, 0.05-6 s; force jitter [N]"
    )
    noise = USUAL.noise
    lines: dict[str, tuple[Rig, dict[str, object]]] = {
        "told M, l, true state": (USUAL, dict(told=TRUE, fed=0)),
        "told M, l, filtered state": (USUAL, dict(told=TRUE, fed=FILTERED)),
        "estimated, true state": (USUAL, dict(fed=0)),
        "estimated, filtered state": (USUAL, {}),
        "estimated, measured z, phi": (USUAL, dict(fed=MEASURED)),
        "noise thought 3 times less": (USUAL, dict(settings=Rig(noise=(3e-5, 1.7e-4)).settings())),
        "noise thought 3 times more": (USUAL, dict(settings=Rig(noise=(3e-4, 1.5e-3)).settings())),
        "5 ms control period": (Rig(noise=noise, hold=5), {}),
        "10 ms control period": (Rig(noise=noise, hold=10), {}),
        "force 2 ms late, unknown": (Rig(noise=noise, late=2), {}),
        "force 5 ms late, unknown": (Rig(noise=noise, late=5), {}),
        "damping 0.1 N s/m, unknown": (Rig(noise=noise, damping=0.1), {}),
        "damping 0.5 N s/m, unknown": (Rig(noise=noise, damping=0.5), {}),
        "dry friction 0.1 N, unknown": (Rig(noise=noise, friction=0.1), {}),
        "dry friction 0.5 N, unknown": (Rig(noise=noise, friction=0.5), {}),
    }
    for unknown in (0.001, 0.003, 0.03, 0.1):
        lines[f"unknown acceleration {unknown:g}"] = (
            USUAL, dict(settings=USUAL.settings(acceleration_noise=unknown))
        )  # fmt: skip
    for accuracy in (0.03, 0.3):
        changes = {"cart_mass_accuracy": accuracy, "half_length_accuracy": accuracy}
        lines[f"accuracy claimed {accuracy:g}"] = (
            USUAL, dict(settings=USUAL.settings(**changes))
        )  # fmt: skip
    for label, (of, options) in lines.items():
        runs = [r for case in CASES for r in ensemble(afl.SCENARIOS[case], of, seeds, **options)]
        alive = [r for r in runs if r.survived]
        cost = np.mean([r.terms[:2].sum() for r in alive])
        mass, length = rms(alive, 0.05, 6.0)
        jitter = np.mean([np.diff(r.force[15_000:]).std() for r in alive])
        print(
            f"  {label:<30} {len(alive):>3}/{len(runs)}   {cost:6.3f}   {mass:5.3f}/{length:5.3f}"
            f"   {jitter:.4f}"
        )


TABLES = {f.__name__: f for f in (cases, tracking, start, pulse, rest, rig)}


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the loop with the estimator.")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--only", nargs="+", choices=TABLES, default=list(TABLES))
    options = parser.parse_args()
    for name in options.only:
        TABLES[name](options.seeds)


if __name__ == "__main__":
    main()
