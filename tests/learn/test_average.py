"""The mean of trained networks."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from gen.errors import InputError
from learn.average import average, main
from learn.weights import load_weights
from tests.learn.small_weights import weights_file


@pytest.mark.parametrize("method", ["group", "diffuse"])
def test_the_mean_is_that_of_every_tensor(method: str, tmp_path: Path) -> None:
    files = []
    for seed in range(3):
        (tmp_path / str(seed)).mkdir()
        files.append(weights_file(tmp_path / str(seed), method, seed))
    average(files, tmp_path / "mean.safetensors")
    found, parts = load_weights(tmp_path / "mean.safetensors"), [load_weights(file) for file in files]
    differing = 0
    for name, value in found.model.state_dict().items():
        tensors = [part.model.state_dict()[name] for part in parts]
        if value.is_floating_point():
            assert torch.allclose(value, torch.stack(tensors).mean(0), rtol=1e-5, atol=1e-7), name
            differing += not torch.equal(value, tensors[-1])
        else:
            assert torch.equal(value, tensors[-1]), name
    assert differing
    assert (found.method, found.options) == (parts[0].method, parts[0].options)
    assert len(found.facts["mean_of"]) == 3


def test_what_has_no_mean_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, other = weights_file(tmp_path, "group"), weights_file(tmp_path, "diffuse")
    out = tmp_path / "mean.safetensors"
    with pytest.raises(InputError, match="two or more"):
        average([one], out)
    with pytest.raises(InputError, match="not the same network"):
        average([one, other], out)
    with pytest.raises(SystemExit) as ended:
        main([str(one), str(tmp_path / "missing"), "-o", str(out)])
    assert ended.value.code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not out.exists()
