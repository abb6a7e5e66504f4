"""An arm of uniform tubes in Exudyn: geometrically exact beams, joints as constraints."""

from __future__ import annotations

from typing import Any

import exudyn as exu
import numpy as np
from exudyn import itemInterface as items  # noqa: N813
from exudyn.rigidBodyUtilities import RotationMatrix2EulerParameters
from numpy.typing import NDArray

from cmbot.elastic import ElasticBase
from cmbot.robot import Robot
from cmbot.trajectory import QuinticTrajectory

FloatArray = NDArray[np.float64]
# cmbot's tubes neither stretch nor shear: neither may these, much.
_STIFFER = 100.0


def simulate(
    robot: Robot, base: ElasticBase, drive: QuinticTrajectory, *, elements: int, step: float, every: int
) -> FloatArray:
    """Find the equilibrium of the first posture, then integrate; tool points (N, 3), m.

    The robot is a carrier on a spring, then equal, uniform tubes along x, each behind a joint about z at the
    end of the one before.
    """
    system = exu.SystemContainer()
    mbs = system.AddSystem()
    started = [False]
    tip = _build(mbs, robot, base, drive, elements, started)
    sensor = mbs.AddSensor(
        items.SensorNode(
            nodeNumber=tip,
            outputVariableType=exu.OutputVariableType.Position,
            storeInternal=True,
            writeToFile=False,
        )
    )
    mbs.Assemble()
    settings = exu.SimulationSettings()
    settings.solutionSettings.writeSolutionToFile = False
    settings.solutionSettings.sensorsWritePeriod = every * step
    settings.timeIntegration.endTime = drive.duration
    settings.timeIntegration.numberOfSteps = round(drive.duration / step)
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.8
    settings.timeIntegration.generalizedAlpha.computeInitialAccelerations = True
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.timeIntegration.newton.relativeTolerance = 1e-6
    settings.staticSolver.newton.relativeTolerance = 1e-8
    settings.staticSolver.numberOfLoadSteps = 5
    settings.linearSolverType = exu.LinearSolverType.EigenSparse
    for solver in (settings.timeIntegration, settings.staticSolver):
        solver.verboseMode = 0
    # Both raise an error of Exudyn's where they do not come to the end.
    mbs.SolveStatic(settings)
    mbs.systemData.SetSystemState(
        mbs.systemData.GetSystemState(), configuration=exu.ConfigurationType.Initial
    )
    started[0] = True
    mbs.SolveDynamic(settings)
    return np.asarray(mbs.GetSensorStoredData(sensor))[:, 1:]


def _build(
    mbs: Any, robot: Robot, base: ElasticBase, drive: QuinticTrajectory, elements: int, started: list[bool]
) -> int:
    """Fill an empty system; the tool's node."""
    carrier, tube = robot.model.inertias[0], robot.elasticity["link_1"]
    com = carrier.lever
    about = carrier.inertia + carrier.mass * (com @ com * np.eye(3) - np.outer(com, com))
    node = mbs.AddNode(items.NodeRigidBodyEP(referenceCoordinates=[0, 0, 0, 1, 0, 0, 0]))
    body = mbs.AddObject(
        items.ObjectRigidBody(
            nodeNumber=node,
            physicsMass=carrier.mass,
            physicsInertia=list(about[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]),
            physicsCenterOfMass=list(com),
        )
    )
    _weigh(mbs, body)
    ground = mbs.AddObject(items.ObjectGround())
    mbs.AddObject(
        items.ObjectConnectorRigidBodySpringDamper(
            markerNumbers=[
                mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=ground, localPosition=[0, 0, 0])),
                mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=body, localPosition=[0, 0, 0])),
            ],
            stiffness=base.stiffness,
        )
    )
    area = np.pi * tube.wall * (tube.outer_diameter - tube.wall)
    EA, EI, GJ = tube.young * area, tube.young * tube.second_moment, 2 * tube.shear * tube.second_moment
    section = exu.BeamSection()
    section.massPerLength = robot.model.inertias[1].mass / tube.length
    section.inertia = section.massPerLength / area * tube.second_moment * np.diag([2.0, 1.0, 1.0])
    shear, axial = _STIFFER * tube.shear * area / 2, _STIFFER * EA
    section.stiffnessMatrix = np.diag([axial, shear, shear, GJ, EI, EI])
    place, R, h = np.zeros(3), np.eye(3), tube.length / elements
    q = drive.states([0.0])[0][0]
    for joint in range(robot.dof):
        turn = robot.model.jointPlacements[joint + 1].rotation
        before = mbs.AddMarker(items.MarkerNodeRigid(nodeNumber=node))
        c, s = np.cos(q[joint]), np.sin(q[joint])
        R = R @ turn @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        node = _node(mbs, place, R)
        mbs.AddObject(
            items.GenericJoint(
                markerNumbers=[before, mbs.AddMarker(items.MarkerNodeRigid(nodeNumber=node))],
                rotationMarker0=turn,
                offsetUserFunctionParameters=[0.0] * 6,
                offsetUserFunction=_angle(drive, joint, started),
            )
        )
        for _ in range(elements):
            place = place + h * R[:, 0]
            last, node = node, _node(mbs, place, R)
            beam = mbs.AddObject(
                items.ObjectBeamGeometricallyExact(
                    nodeNumbers=[last, node], physicsLength=h, sectionData=section
                )
            )
            _weigh(mbs, beam)
    payload = mbs.AddObject(
        items.ObjectRigidBody(
            nodeNumber=node, physicsMass=robot.payload, physicsInertia=[1e-9] * 3 + [0.0] * 3
        )
    )
    _weigh(mbs, payload)
    return int(node)


def _angle(drive: QuinticTrajectory, joint: int, started: list[bool]) -> Any:
    """What the joint is told. The static solver's time is none: until then the first posture is held."""

    def offset(mbs: Any, t: float, number: int, parameters: Any) -> list[float]:
        del mbs, number, parameters
        return [0.0, 0.0, 0.0, 0.0, 0.0, float(drive.states([t if started[0] else 0.0])[0][0, joint])]

    return offset


def _node(mbs: Any, place: FloatArray, R: FloatArray) -> Any:
    return mbs.AddNode(
        items.NodeRigidBodyEP(referenceCoordinates=[*place, *RotationMatrix2EulerParameters(R)])
    )


def _weigh(mbs: Any, body: Any) -> None:
    marker = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=body))
    mbs.AddLoad(items.LoadMassProportional(markerNumber=marker, loadVector=[0, 0, -9.81]))
