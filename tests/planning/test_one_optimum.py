"""One optimum on every processor: OpenBLAS' kernels round differently, plans may not."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

# Kernels that differ most; which of them a processor has is asked of its flags.
KERNELS = {"Haswell": "avx2", "SkylakeX": "avx512f", "Sandybridge": "avx", "Nehalem": "sse4_2"}
CODE = """
import json, sys
from dataclasses import asdict, replace
import cmbot
from threadpoolctl import threadpool_info

scene = cmbot.load_scene(sys.argv[1])
plan = cmbot.plan(replace(scene, planner=replace(scene.planner, **json.loads(sys.argv[2]))))
figures = plan.figures
kernels = {each["architecture"] for each in threadpool_info() if each["internal_api"] == "openblas"}
print(json.dumps({
    "kernels": sorted(kernels),
    "peak": figures.peak_guardrail_torque,
    "mean": figures.mean_guardrail_torque,
    "clearance": figures.min_clearance,
    **asdict(figures.limit_use),
    "deviation": figures.max_tool_deviation,
    "q": plan.trajectory.q.tolist(),
}))
"""


def supported() -> list[str]:
    """Two kernels that this processor can run, as different as can be."""
    info = Path("/proc/cpuinfo")
    flags = set(info.read_text(encoding="utf-8").split()) if info.exists() else set()
    found = [kernel for kernel, flag in KERNELS.items() if flag in flags]
    return [found[0], found[-1]] if len(found) > 1 else found


def planned(scene: str, kernel: str, **options: object) -> dict[str, object]:
    words = [sys.executable, "-c", CODE, scene, json.dumps(options)]
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    answer = json.loads(done.stdout)
    assert answer.pop("kernels") == [kernel]
    return answer


@pytest.mark.skipif(len(supported()) < 2, reason="only one of OpenBLAS' kernels runs on this processor")
@pytest.mark.parametrize("scene", ["triangle", "line"])
def test_plans_do_not_depend_on_the_kernel(scene: str) -> None:
    first, second = (planned(scene, kernel) for kernel in supported())
    here, there = (np.array(each.pop("q")) for each in (first, second))
    for name, value in first.items():
        assert second[name] == pytest.approx(value, rel=1e-3), name
    np.testing.assert_allclose(here, there, rtol=0, atol=2e-3)
