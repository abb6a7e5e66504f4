"""The stiffness that a scene says was identified, in place of the model's, and its covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.reading.validation import counted
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import arm_modes, frequency_slopes
from cmbot.elastic.stiffness_parameters import StiffnessParameters
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, Scene

# By what share a modelled stiffness may differ from what an identified one was compared with.
_STIFFNESS_TOLERANCE = 1e-6
# Standard deviations of the modes' stiffness that are allowed for.
_COVERED_SIGMAS = 2.0


def modelled_stiffness(robot: Robot) -> dict[tuple[str, str], float]:
    """Return what factors are of: of links E I, N m2, of joints Nm/rad, by kind and name."""
    links = {("link", name): tube.young * tube.second_moment for name, tube in robot.elasticity.items()}
    return links | {("joint", name): spring.stiffness for name, spring in robot.joint_elasticity.items()}


def with_identified_stiffness(robot: Robot, scene: Scene) -> Robot:
    """Return a robot whose links and joints are as stiff, and whose modes damped, as a scene says.

    Raises
    ------
    SceneError
        When they were identified for another robot.
    """
    if (identified := scene.identified) is None:
        return robot
    modelled = modelled_stiffness(robot)
    given = (*identified.links, *identified.joints)
    for spring, each in zip(identified.springs, given, strict=True):
        key = f"identified.{spring[0]}s"
        known = modelled.get(spring)
        if known is None:
            names = tuple(name for kind, name in modelled if kind == spring[0])
            raise SceneError(scene.source, key, each.name, f"a {spring[0]} that bends", names)
        if abs(each.modelled / known - 1) > _STIFFNESS_TOLERANCE:
            expected = f"{known:g}, as the robot's model has it: the stiffness is that of another robot"
            raise SceneError(scene.source, f"{key} of {each.name}", f"modelled: {each.modelled:g}", expected)
    factors = {spring: each.factor for spring, each in zip(identified.springs, given, strict=True)}
    tubes = {
        name: replace(tube, young=by * tube.young, shear=by * tube.shear)
        for name, tube in robot.elasticity.items()
        for by in [factors.get(("link", name), 1.0)]
    }
    springs = {
        name: replace(spring, stiffness=by * spring.stiffness, tilting=spring.tilting and by * spring.tilting)
        for name, spring in robot.joint_elasticity.items()
        for by in [factors.get(("joint", name), 1.0)]
    }
    damping = robot.damping_ratio if identified.damping is None else identified.damping.ratio
    return replace(robot, elasticity=tubes, joint_elasticity=springs, damping_ratio=damping)


def identified_in_words(scene: Scene) -> str | None:
    """Return what is as stiff as identified, and which keys of the scene that replaces; None: nothing is."""
    if (identified := scene.identified) is None:
        return None
    of = [counted(len(identified.links), "link"), counted(len(identified.joints), "joint")]
    replaced = []
    if identified.base is not None:
        of.append(scene.base_name)
        given = scene.guardrail
        replaced = [
            f"guardrail.{key}"
            for key in ("stiffness", "mass", "stiffness_factor")
            if getattr(given, key) is not None
        ]
    instead = f" It replaces {' and '.join(replaced)} of the scene." if replaced else ""
    damping = identified.damping and f" Damping as identified: {100 * identified.damping.ratio:.2g} %."
    return f"Stiffness as identified, not as modelled: {', '.join(of)}.{instead}{damping or ''}"


def known_share(scene: Scene, arm: ElasticArm, options: PlannerOptions) -> PlannerOptions:
    """Return options whose `quiet_stiffness_share` is what an identified stiffness leaves open.

    Twice the standard deviation of the stiffness of the slowest modes, by their frequencies in the scene's
    posture, where that is less.
    """
    if (covariance := covariance_of(scene, arm)) is None:
        return options
    parameters = StiffnessParameters(arm)
    zero = np.zeros(parameters.count)
    posture = np.array(scene.posture)
    slowest = arm_modes(arm, posture).shapes[:, : max(options.quiet_modes, 1)]
    _, slopes = frequency_slopes(arm, parameters, zero, posture, slowest)
    # A mode's stiffness goes with the square of its frequency.
    deviation = 2 * np.sqrt(np.einsum("kp,pr,kr->k", slopes, covariance, slopes).max())
    share = min(options.quiet_stiffness_share, round(float(_COVERED_SIGMAS * deviation), 3))
    return replace(options, quiet_stiffness_share=share)


def covariance_of(scene: Scene, arm: ElasticArm) -> FloatArray | None:
    """Return the covariance (p, p) of the `StiffnessParameters` of a scene's arm; None where none is known.

    Raises
    ------
    SceneError
        When it is of other parameters.
    """
    if (identified := scene.identified) is None:
        return None
    parameters = StiffnessParameters(arm)
    if parameters.springs != identified.springs or parameters.has_base != (identified.base is not None):
        wanted = [name for _, name in parameters.springs] + ["base"] * parameters.has_base
        got = [name for _, name in identified.springs] + ["base"] * (identified.base is not None)
        expected = f"what bends in this scene, in this order: {', '.join(wanted)}"
        raise SceneError(scene.source, "identified", ", ".join(got), expected)
    return np.asarray(identified.covariance_matrix)
