"""Which engine solves for the whole past is a setting, and the smoother's answer is the same with either."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from program import Call
from walks import ns

from estimators import engines
from estimators.config import ENGINES, Config, Graph
from estimators.config_file import load_config, with_settings
from estimators.smoother import Smoother
from estimators.solution import Solution
from fieldloc import pose as se2
from fieldloc.errors import FieldlocError
from fieldloc.factors import PoseFactor
from fieldloc.measurements import Odometry
from logs.samples import sample_path


def smoothed(engine: str) -> Solution:
    smoother = Smoother(Config(graph=Graph(engine=engine)))
    random = np.random.default_rng(1)
    truth = np.zeros(3)
    for k in range(100):
        smoother.predict(Odometry(ns(0.1 * k), np.array([0.5, 0.0, 0.4])))
        if k % 5 == 0:
            seen = se2.retract(truth, 0.05 * random.standard_normal(3))
            smoother.update(PoseFactor(ns(0.1 * k), seen, 0.05**2 * np.eye(3)))
        truth = se2.retract(truth, np.array([0.05, 0.0, 0.04]))
    smoother.trajectory()
    assert smoother.solution is not None
    return smoother.solution


def test_the_smoothers_answer_is_the_same_with_either_engine() -> None:
    gtsam, chain = (smoothed(engine) for engine in ENGINES)
    np.testing.assert_allclose(chain.poses, gtsam.poses, rtol=0, atol=1e-4)
    sigmas = np.sqrt(np.diagonal(gtsam.covariances, axis1=1, axis2=2))
    whole = sigmas[:, :, None] * sigmas[:, None, :]  # a correlation of nearly zero is not known to a part of itself
    np.testing.assert_allclose(chain.covariances / whole, gtsam.covariances / whole, rtol=0, atol=1e-3)
    assert not np.array_equal(chain.poses, gtsam.poses)


def test_the_engine_is_a_setting_and_in_the_file(tmp_path: Path) -> None:
    assert Config().graph.engine == "gtsam"
    for value in ("chain", "'chain'", '"chain"'):
        assert with_settings(Config(), [f"graph.engine={value}"]).graph.engine == "chain"
    path = tmp_path / "settings.toml"
    path.write_text('[graph]\nengine = "chain"\ncauchy = 3')
    assert load_config(path) == Config(graph=Graph(cauchy=3.0, engine="chain"))


def test_an_engine_that_does_not_exist_is_named_with_those_that_do() -> None:
    with pytest.raises(FieldlocError, match=r"graph\.engine.*gtsam, chain.*'g2o'"):
        with_settings(Config(), ["graph.engine=g2o"])
    with pytest.raises(ValueError, match=r"graph\.engine.*'g2o'.*gtsam, chain"):
        engines.solver(replace(Config(), graph=Graph(engine="g2o")))


def test_the_command_line_smooths_with_the_engine_that_is_named(call: Call, tmp_path: Path) -> None:
    for engine in ENGINES:
        out = tmp_path / f"{engine}.mcap"
        assert call("smooth", sample_path("woods"), "--to", "10", "--engine", engine, "-o", out).code == 0
        assert f'"engine": "{engine}"' in call("info", out, "--json").out.replace("\\", "")
    said = call("smooth", sample_path("woods"), "--engine", "g2o")
    assert said.code == 1
    assert "g2o" in said.err


def test_without_numba_the_chain_engine_works_and_says_nothing() -> None:
    code = (
        "import sys; sys.modules['numba'] = None\n"
        "import estimators.chain_engine as engine\n"
        "engine.prepare()\n"
        "assert engine.arithmetic().__name__ == 'InArrays', engine.arithmetic()\n"
        "assert 'gtsam' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_compiled_code_that_cannot_be_kept_is_compiled_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    from estimators.chain_engine import jit

    def nowhere(**_: object) -> object:
        raise RuntimeError("cannot cache function 'f': no locator available for file")

    real = jit.numba.njit
    monkeypatch.setattr(jit.numba, "njit", lambda f=None, **how: nowhere() if how.get("cache") else real(f, **how))
    assert jit.compiled(lambda x: x + 1.0)(2.0) == 3.0
