"""`slider published --all` on a coarse mesh: files, and a run that is interrupted."""

import json

import pytest

from slider_jax.cli.main import main
from slider_jax.statements import investigation, report, series
from slider_jax.statements.assumptions import RANGES
from slider_jax.statements.quantities import COARSE
from slider_jax.statements.statements import GIVEN, PRINTED, SIMULATED
from tests.support.fronts import front_of


class Interrupted(Exception):
    pass


@pytest.fixture
def small(monkeypatch):
    for module in (investigation, report, series):
        monkeypatch.setattr(module, "FINE", COARSE)
    monkeypatch.setattr(investigation, "POPULATION", 8)
    monkeypatch.setattr(investigation, "GENERATIONS", 2)
    monkeypatch.setattr(investigation, "POINTS", 4)
    monkeypatch.setattr(investigation, "CHANGES", 2)


@pytest.mark.slow
def test_an_interrupted_comparison_resumes_and_writes_all_files(small, tmp_path, capsys):
    told = []

    def stop_at_the_second_map(text):
        told.append(text)
        if "map of phase" in text:
            raise Interrupted

    with pytest.raises(Interrupted):
        report.write_comparison(tmp_path, lambda x: "", "program", stop_at_the_second_map)
    (folder,) = tmp_path.glob("partial-*")
    assert (folder / "map of EI_tail, built-in robot.json").exists()
    before = {path.name: path.stat().st_mtime_ns for path in folder.glob("facts_*.json")}
    content = report.write_comparison(
        tmp_path, lambda x: x["said"], "program", told.append, front_of(5)
    )
    after = json.loads((tmp_path / "published.json").read_text())
    assert before and content == after and not list(tmp_path.glob("partial-*"))
    names = [x["name"] for x in after["statements"]]
    assert {*SIMULATED, *PRINTED, *GIVEN} <= set(names) and len(set(names)) == len(names)
    kinds = {x["kind"] for x in after["statements"]}
    assert kinds == {"simulated", "map", "optimum", "multimodal", "printed", "given"}
    pictures = {path.name for path in tmp_path.glob("*.png")}
    assert pictures == {
        "fig4.png", "fig5.png", "fig6.png", "fig7_built-in_robot.png",
        "fig7_joint_assumptions.png", "fig7c.png", "fig8.png", "fig9.png",
    }  # fmt: skip
    assert after["figures"] == sorted(pictures)
    short, long = (after["head_drag"][i]["speed_53_mm_m_per_s"] for i in (0, 1))
    assert long < short
    known = after["facts"]["built-in robot"]["speed_m_per_s"]
    assert short == pytest.approx(known, rel=1e-4)
    # An end of a range that the built-in robot has is no change.
    ends = {(x["assumption"], round(x["value"], 6)) for x in after["single_changes"]}
    assert ("k", 0.02) in ends and ("phase", 0.3) in ends
    assert len(ends) == len(after["single_changes"]) < 2 * len(RANGES)
    assert (tmp_path / "published.html").read_text() == after["said"]
    assert sum("sets" in text for text in told) == 2 * len(before)
    # The command reads the front and makes the page.
    (tmp_path / "front").mkdir()
    (tmp_path / "front" / "multimodal.json").write_text(json.dumps(front_of(5)))
    front = ["--front", str(tmp_path / "front")]
    assert main(["published", "--all", "--out", str(tmp_path), *front]) == 0
    assert after["said"] in (tmp_path / "published.html").read_text()
    assert "sweep peak frequency" in capsys.readouterr().out
