"""One optimum on every processor: OpenBLAS' kernels round differently, plans may not."""

import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from cmbot.planning import Plan

# Kernels that differ most; which of them a processor has is asked of its flags.
KERNELS = {"Haswell": "avx2", "SkylakeX": "avx512f", "Sandybridge": "avx", "Nehalem": "sse4_2"}
CODE = """
import json, sys
from dataclasses import asdict
import cmbot
from threadpoolctl import threadpool_info

from cmbot.planning import Plan

plan = cmbot.plan(cmbot.load_scene(sys.argv[1]))
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


def other_kernels() -> list[str]:
    """Kernels that this processor can run, and this process does not, the most different last."""
    info = Path("/proc/cpuinfo")
    flags = set(info.read_text(encoding="utf-8").split()) if info.exists() else set()
    here = {each["architecture"] for each in threadpool_info() if each["internal_api"] == "openblas"}
    return [kernel for kernel, flag in KERNELS.items() if flag in flags and kernel not in here]


def planned(scene: str, kernel: str) -> dict[str, object]:
    words = [sys.executable, "-c", CODE, scene]
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    answer = json.loads(done.stdout)
    assert answer.pop("kernels") == [kernel]
    return answer


@pytest.mark.skipif(not other_kernels(), reason="only one of OpenBLAS' kernels runs on this processor")
def test_plans_do_not_depend_on_the_kernel(triangle_plan: Plan) -> None:
    """That of this process and the one that differs most from it."""
    here = triangle_plan
    there = planned("triangle", other_kernels()[-1])
    figures = here.figures
    for name, value in {
        "peak": figures.peak_guardrail_torque,
        "mean": figures.mean_guardrail_torque,
        "clearance": figures.min_clearance,
        **asdict(figures.limit_use),
        "deviation": figures.max_tool_deviation,
    }.items():
        assert there.pop(name) == pytest.approx(value, rel=1e-3), name
    np.testing.assert_allclose(there.pop("q"), here.trajectory.q, rtol=0, atol=2e-3)
    assert not there
