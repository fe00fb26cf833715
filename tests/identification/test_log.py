import re
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.identification import description as described
from afl_mujoco.identification import log as logs
from afl_mujoco.identification.description import load_description
from afl_mujoco.identification.log import cut, log_of, read_log, read_logs, write_log
from afl_mujoco.identification.prediction import CHOOSE, DESCRIPTION, FIT
from tests.messages import line
from tests.synthetic_logs import Truth, swing

TRUTH = Truth()
PLAIN = TRUTH.description
(RECORDED,) = FIT.glob("Experiment-1008.csv")


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    return swing(TRUTH, 1, 2.0)


def written(folder, columns: dict[str, np.ndarray]):
    path = folder / "mine.csv"
    write_log(path, columns)
    return path


def test_a_log_reads_as_it_was_written_and_its_stamps_are_a_regular_device_s(tmp_path, columns):
    log = read_log(written(tmp_path, columns), PLAIN)
    assert log.name == "mine" and log.missing == 0 and log.valid.all()
    assert log.z == pytest.approx(columns["z"], abs=1e-8)
    assert log.command == pytest.approx(columns["command"], abs=1e-8)
    assert np.abs(np.diff(log.angle)).max() < 1.0  # turns are counted
    log = log_of("mine", columns, PLAIN)
    assert log.jitter == pytest.approx(1e-4, rel=0.3)
    assert log.period == pytest.approx(0.02, rel=1e-4) and np.ptp(np.diff(log.time)) < 1e-12


def test_stamps_that_the_readings_follow_are_kept_and_others_are_not() -> None:
    even = 0.02 * np.arange(300)
    uneven = even + np.random.default_rng(0).normal(0.0, 0.004, 300)  # a fifth of the period

    def read(at, stamps):
        columns = {"phi": np.sin(5.0 * at), "z": 0.3 * np.cos(3.0 * at), "command": 0.0 * at}
        return log_of("mine", {"time": stamps, **columns}, PLAIN)

    followed, late = read(uneven, uneven), read(even, uneven)
    assert followed.time == pytest.approx(uneven - uneven[0], abs=1e-9)
    assert np.ptp(np.diff(late.time)) < 1e-9
    for log in (followed, late):
        assert log.missing == 0 and log.jitter == pytest.approx(0.004, rel=0.1)


@pytest.mark.parametrize("scatter", [0.0, 0.3])
def test_lost_rows_are_found_however_the_stamps_scatter(columns, scatter) -> None:
    rng = np.random.default_rng(1)
    count = len(columns["time"])
    kept = rng.random(count) > 0.05
    kept[[0, -1]] = True
    time = 1e4 + 0.02 * (np.arange(count) + rng.uniform(-scatter, scatter, count))
    table = {name: values[kept] for name, values in {**columns, "time": time}.items()}
    log = log_of("mine", table, PLAIN)
    assert list(log.slots) == list(np.flatnonzero(kept)) and log.missing == (~kept).sum()
    assert np.diff(log.time) == pytest.approx(log.period * np.diff(log.slots))


def test_strong_jitter_is_no_lost_row() -> None:
    for seed in range(12):
        rng, columns = np.random.default_rng(seed), swing(TRUTH, seed, 4.0)
        columns["time"] = 0.02 * (np.arange(200) + np.clip(rng.normal(0.0, 0.2, 200), -0.45, 0.45))
        log = log_of("late", columns, TRUTH.description)
        assert log.missing == 0 and log.period == pytest.approx(0.02, rel=2e-3)


def test_units_and_signs_and_that_the_shipped_recordings_are_all_there(columns) -> None:
    phi = described.AngleColumn(unit="deg", sign=-1, zero=2.0)
    other = replace(PLAIN, phi=phi, z=described.PositionColumn(unit="mm", sign=-1))
    turned = {**columns, "phi": 2.0 - np.degrees(columns["phi"]), "z": -1e3 * columns["z"]}
    here, there = log_of("a", columns, PLAIN), log_of("a", turned, other)
    assert there.angle == pytest.approx(here.angle, abs=1e-9)
    assert there.z == pytest.approx(here.z, abs=1e-12)
    description = load_description(DESCRIPTION)
    assert [len(read_logs([folder], description)) for folder in (FIT, CHOOSE)] == [40, 20]
    assert sum(path.stat().st_size for path in FIT.parent.rglob("*.csv")) < 1e6


def test_readings_grow_through_a_dead_zone_and_degrees_would_be_more_than_a_turn() -> None:
    log = read_log(RECORDED, load_description(DESCRIPTION))
    assert 0.9 < log.valid.mean() < 1.0
    assert log.phi[log.valid].max() <= 0.95 and log.phi.min() >= 1.15 - 2.0 * np.pi - 1e-9
    assert np.abs(np.diff(log.angle)).max() < 0.5  # 13 rad/s and a count
    description = load_description(DESCRIPTION)
    table = np.genfromtxt(RECORDED, delimiter=",", names=True)
    columns = {name: table[name] for name in table.dtype.names}
    said = r"^angle must lie within a turn, 6\.283 rad \(or its unit is wrong\), got a range"
    with pytest.raises(AflMujocoError, match=said):
        log_of("mine", {**columns, "angle": np.degrees(columns["angle"])}, description)


def changed(columns, name: str, row: int, value: float) -> dict[str, np.ndarray]:
    return {**columns, name: np.where(np.arange(len(columns[name])) == row, value, columns[name])}


BAD = {
    "phi must be numbers below 1e+07, got nan in row 8": lambda c: changed(c, "phi", 7, np.nan),
    "time must increase from row to row, got a decrease in row 6": (
        lambda c: changed(c, "time", 5, 0.0)),
    "phi must be numbers below 1e+07, got 1e+19 in row 8": lambda c: changed(c, "phi", 7, 1e19),
    "z must not jump there and back within two rows (mend the log, or leave the rows out), got +": (
        lambda c: {**c, "z": c["z"] + (np.arange(100) == 7)}),
    "rad in row 2": lambda c: {**c, "phi": c["phi"] + 2.0 * (np.arange(100) == 0)},
    "m in row 50": lambda c: {**c, "z": c["z"] + 50.0 * np.isin(np.arange(100), (49, 50))},
    "phi must not jump there and back": (
        lambda c: {**c, "phi": c["phi"] + 7.0 * (np.arange(100) == 40)}),
    "command must be within 1, got 1.5": lambda c: changed(c, "command", 3, 1.5),
    "phi must vary: the angle is constant in this log": lambda c: {**c, "phi": 0.0 * c["phi"]},
    "rows must be at least 50, got 20": lambda c: {name: x[:20] for name, x in c.items()},
}  # fmt: skip


@pytest.mark.parametrize("said", BAD)
def test_a_log_that_breaks_a_rule_is_refused(columns, said: str) -> None:
    with pytest.raises(AflMujocoError, match=re.escape(said)):
        log_of("mine", BAD[said](columns), PLAIN)


@pytest.mark.parametrize(("separator", "point"), [(";", ","), ("\t", "."), (",", ",")])
def test_any_usual_separator_and_decimal_sign_reads_the_same(tmp_path, columns, separator, point):
    path = written(tmp_path, columns)
    here = read_log(path, PLAIN)
    quote = '"' if point == separator else ""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    lines = (separator.join(f"{quote}{x.replace('.', point)}{quote}" for x in row) for row in rows)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8-sig")
    there = read_log(path, PLAIN)
    assert (there.phi == here.phi).all() and (there.command == here.command).all()


@pytest.mark.parametrize(("change", "encoding", "message"), [
    (("0.08,", "0.08,,"), "utf-8", "row 5 (line 6) must have 4 values, separated by commas"),
    (("\n0.08,", "\n# a note\n\nx,"), "utf-8", "row 5 (line 8) must have a number in column 't"),
    (("0.08,", "0.0_8,"), "utf-8", "row 5 (line 6) must have a number in column 'time', separated"),
    (("command", "comand"), "utf-8",
     "column 'command' is missing; the columns are time, phi, z, comand; did you mean comand?"),
    (("", ""), "utf-16", "cannot be read: not UTF-8 text: save it as UTF-8"),
], ids=lambda value: value if value == "utf-16" else "")  # fmt: skip
def test_what_is_wrong_in_a_log_is_named(tmp_path, columns, change, encoding, message) -> None:
    path = written(tmp_path, {**columns, "time": 0.02 * np.arange(len(columns["time"]))})
    text = path.read_text().replace(*change) if change[0] else path.read_text()
    path.write_text(text, encoding=encoding)
    with pytest.raises(AflMujocoError, match=f"(?s)^{re.escape(str(path))}.*{re.escape(message)}"):
        read_log(path, PLAIN)


def test_no_logs_files_too_large_and_names_that_come_twice(tmp_path, columns, monkeypatch):
    for text in ("", "time,phi,z,command\n1,2,three,4\n", "\x00\xff"):
        (tmp_path / "bad.csv").write_bytes(text.encode("latin-1"))
        with pytest.raises(AflMujocoError, match=r"bad\.csv"):
            read_log(tmp_path / "bad.csv", PLAIN)
    (tmp_path / "empty").mkdir()
    with pytest.raises(AflMujocoError, match=r"empty must contain logs, \*\.csv"):
        read_logs([tmp_path / "empty"], PLAIN)
    path = written(tmp_path, columns)
    with pytest.raises(AflMujocoError, match="log names must differ, got 'mine' twice"):
        read_logs([path, path], PLAIN)
    monkeypatch.setattr(logs, "MOST_BYTES", 1000)
    with pytest.raises(AflMujocoError, match=r"must be at most 0\.001 MB"):
        read_log(written(tmp_path, columns), PLAIN)


def test_a_lost_row_ends_a_window_and_logs_shorter_than_one_are_refused() -> None:
    kept = np.delete(np.arange(200), [12, 60, 65, 130])
    log = log_of("a", {name: x[kept] for name, x in swing(TRUTH, 5).items()}, PLAIN)
    windows = cut([log], 0.5, 0.5)
    rows = zip(windows.time / log.period, windows.there, strict=True)
    starts, ends = np.round([(t[0], t[m > 0.0][-1]) for t, m in rows]).T
    assert starts.tolist() == [0, 13, 38, 66, 91, 116, 131, 156, 181]
    assert ends.tolist() == [11, 38, 59, 91, 116, 129, 156, 181, 199]
    assert windows.dropped == 1  # rows 61 to 64
    assert windows.share == pytest.approx(1.0 - 11.0 / 199.0, abs=1e-3)
    with pytest.raises(AflMujocoError, match="logs must include one longer than 9 s"):
        cut([log], 9.0, 1.0, least=None)


GOOD = """
name = "mine"
period = 0.01
nominal = {pole_mass = 0.1, half_length = 0.25, cart_mass = 0.5, force = 5.0}
[phi]
unit = "deg"
resolution = 0.1
"""


def test_units_signs_and_defaults_are_read_and_what_is_written_reads_back(tmp_path) -> None:
    (tmp_path / "rig.toml").write_text(GOOD)
    one = load_description(tmp_path / "rig.toml")
    assert one.columns == {"time": "time", "phi": "phi", "z": "z", "command": "command"}
    assert one.phi.count == pytest.approx(0.0017453, rel=1e-4)
    assert one.nominal.gravity_term == pytest.approx(29.43)
    one = load_description(DESCRIPTION)
    (tmp_path / "again.toml").write_text(tomli_w.dumps(described.to_table(one)))
    assert load_description(tmp_path / "again.toml") == one


@pytest.mark.parametrize(("before", "after", "message"), [
    ("period = 0.01", "period = 0.0", "period must be positive, got 0"),
    ('unit = "deg"', 'unit = ["deg"]', "phi.unit must be one of rad, deg, turn, got ['deg']"),
    ('unit = "deg"', 'unit = "dge"', "phi.unit must be one of rad, deg, turn, got 'dge'; did"),
    ("resolution = 0.1", "dead_zone = [2.0, 1.0]", "dead_zone must increase, got [2.0, 1.0]"),
    ("resolution = 0.1", 'column = "z"', "column names must differ, got 'z' twice"),
    ("pole_mass = 0.1, ", "", "nominal.pole_mass is missing"),
])  # fmt: skip
def test_what_breaks_a_rule_is_named(tmp_path, before: str, after: str, message: str) -> None:
    (tmp_path / "rig.toml").write_text(GOOD.replace(before, after))
    with pytest.raises(AflMujocoError, match=line(..., "rig.toml", ..., message, ...)):
        load_description(tmp_path / "rig.toml")
