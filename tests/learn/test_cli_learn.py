"""The commands `degloss learn ...`: what they print and write, refusals in one line, and help that imports nothing heavy."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Capture
from gen.errors import InputError, MissingPart
from gen.formats.render_folder import write_render
from gen.images import read_raw, write_png
from learn.cli import app
from learn.method import METHODS
from learn.predict import as_stored
from learn.shipped import shipped_weights
from tests.learn.small_weights import OPTIONS, weights_file

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = ("train", "eval", "predict", "export", "table1", "methods", "weights")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Small weights of each method."""
    folder = tmp_path_factory.mktemp("weights")
    return {method: weights_file(folder, method) for method in METHODS}


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory, synthetic: Callable[..., Capture]) -> Path:
    """A rendered capture's folder."""
    folder = tmp_path_factory.mktemp("captures") / "cylinder"
    write_render(synthetic("cylinder", 40, alpha=0.4, specular=0.5), folder)
    return folder


def call(*tokens: str | Path) -> None:
    app([str(token) for token in tokens], exit_on_error=False, result_action="return_value")


def test_help_imports_nothing_heavy() -> None:
    """Of every command, in one fresh interpreter."""
    code = (
        "import sys\nfrom degloss import app\n"
        f"for name in {COMMANDS!r}:\n    app(['learn', name, '--help'], exit_on_error=False, result_action='return_value')\n"
        "print('HEAVY', *sorted({'torch', 'numpy', 'cv2', 'skimage', 'scipy', 'safetensors', 'rich.progress'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert run.stdout.splitlines()[-1].split() == ["HEAVY"]
    assert all(f"degloss learn {name}" in run.stdout for name in COMMANDS)


def test_eval_prints_and_writes(
    files: dict[str, Path], capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("eval", files["group"], capture, "-o", tmp_path / "out", "--json")
    result = json.loads(capsys.readouterr().out)
    assert result == json.loads((tmp_path / "out" / "results.json").read_text())
    assert result["method"] == "group"
    assert result["counts"] == {"captures": 1, "pictures": 5, "captures measured": 1}
    assert {"glossy", "group", "group, repaired", "true diffuse", "true matte"} <= set(result["measurement"])
    assert result["pictures"]["all"]["all"]["group"]["matte"]["mse"] > 0
    assert read_raw(tmp_path / "out" / "pictures.png").shape[2] == 3
    call("eval", files["specular"], capture, "--no-measure")
    printed = capsys.readouterr().out
    assert "do nothing" in printed
    assert "low-rank" in printed
    assert "photometric stereo:" not in printed


def test_predict_takes_pictures_before_and_after_options(
    files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    pictures = [tmp_path / f"{k}.png" for k in range(2)]
    for picture in pictures:
        write_png(picture, as_stored(rng.uniform(0, 1, (12, 16, 3)).astype(np.float32), 8, "srgb"))
    call("predict", files["specular"], *pictures, "-o", tmp_path / "one")
    assert capsys.readouterr().out.count("12") >= 2
    call("predict", files["specular"], "-o", tmp_path / "two", "--json", *pictures)
    result = json.loads(capsys.readouterr().out)
    assert [Path(one["source"]) for one in result["pictures"]] == pictures
    assert sorted(p.name for p in (tmp_path / "two").iterdir() if p.suffix == ".png") == [
        f"{k}-{layer}.png" for k in range(2) for layer in ("diffuse", "specular")
    ]


def test_export(files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call("export", files["specular"], "-o", tmp_path / "net.pt", "--format", "torch", "--json")
    assert json.loads(capsys.readouterr().out)["difference"]["most"] < 5e-3
    with pytest.raises(InputError, match="weights themselves"):
        call("export", files["specular"], "-o", files["specular"], "--format", "torch")
    assert [p.name for p in tmp_path.iterdir()] == ["net.pt"]


def test_table1(files: dict[str, Path], capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chosen = [word for method in METHODS for word in (f"--{method}", files[method])]
    call("table1", "--test", capture, *chosen, "-o", tmp_path / "out", "--json")
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {rows[method]["letter"] for method in METHODS} == {"(a)", "(b)", "(c)", "(d)"}
    assert all(rows[method]["test"]["mse"] > 0 for method in METHODS)
    assert (tmp_path / "out" / "table1.png").is_file()
    call("table1", "--test", capture, *chosen)
    assert "(d) group" in capsys.readouterr().out


def test_lists(files: dict[str, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    call("methods", "--json")
    listed = json.loads(capsys.readouterr().out)
    assert set(listed["methods"]) == set(METHODS)
    assert all(row["source"] for row in listed["methods"].values())
    call("methods")
    assert "LIME" in capsys.readouterr().out
    monkeypatch.setattr("learn.weights.SHIPPED", files["group"].parent)
    found = shipped_weights()
    assert {name: row["options"] for name, row in found.items()} == OPTIONS
    call("weights")
    assert "seed 0" in capsys.readouterr().out
    monkeypatch.setattr("learn.weights.SHIPPED", ROOT / "no such folder")
    call("weights")
    assert "no weights" in capsys.readouterr().out


def test_refusals(files: dict[str, Path], capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for tokens, says in (
        (("eval", tmp_path / "none.safetensors", capture), "no such file of weights"),
        (("eval", files["group"], tmp_path / "none"), "no such file"),
        (("eval", files["group"], capture, "--repair", "tape"), "tape"),
        (("eval", files["group"], capture, "--device", "tpu"), "tpu"),
        (("eval", files["group"], capture, "-o", capture), "choose another place"),
        (("predict", files["group"], tmp_path / "none.png", "-o", out), "none.png"),
        (("export", files["group"], "-o", out, "--format", "torch", "--pictures", "1"), "from 3"),
        (("table1", "--test", capture, "--lime", files["group"], "--limit", "3"), "not of lime"),
        (("train", "no-such-config", "-o", out), "no-such-config"),
        (("train", "smoke-specular", "-o", out, "--data", "pack"), "KEY=VALUE"),
    ):
        with pytest.raises(InputError, match=says) as refusal:
            call(*tokens)
        assert "\n" not in str(refusal.value)
    assert list(tmp_path.iterdir()) == []


def test_without_torch_it_is_said(files: dict[str, Path], capture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where the package is not installed: the remedy, and nothing else."""
    monkeypatch.setattr("gen.parts.find_spec", lambda name: None)
    for tokens in (
        ("eval", files["group"], capture),
        ("predict", files["group"], "a.png", "-o", "x"),
        ("export", files["group"], "-o", "x"),
        ("table1",),
        ("train", "smoke-group", "-o", "x"),
    ):
        with pytest.raises(MissingPart, match="pip install"):
            call(*tokens)


def test_the_front_door_refuses_in_one_line(files: dict[str, Path], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "degloss", "learn", "predict", str(files["lime"]), "no.png", "-o", str(tmp_path / "out")]
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr.startswith("degloss: no.png")
    assert run.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
