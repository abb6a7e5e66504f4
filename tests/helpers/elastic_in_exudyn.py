"""An arm of uniform tubes in Exudyn: geometrically exact beams, joints as constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import exudyn as exu
import numpy as np
from exudyn import itemInterface as items  # noqa: N813
from exudyn.rigidBodyUtilities import RotationMatrix2EulerParameters
from numpy.typing import NDArray

from cmbot.simulation import PrescribedMotion

FloatArray = NDArray[np.float64]
# cmbot's tubes neither stretch nor shear: neither may these, much.
_STIFFER = 100.0


@dataclass(frozen=True, kw_only=True)
class BeamArm:
    """A carrier on a spring, then tubes along x, each behind a joint about z at the end of the one before.

    Attributes
    ----------
    base_stiffness : (6, 6)
    carrier : mass, kg; inertia about the origin of W (xx, yy, zz, yz, xz, xy), kg m2; centre of mass, m
    turns : (n, 3, 3)
        From each joint's frame, at joint angle zero, to what it stands on.
    length, mass_per_length : float
    EI, GJ, EA, GA : float
    polar_inertia : float, kg m
        Of the cross-section, per length: about x; half of it about y and z.
    payload : float, kg
    """

    base_stiffness: FloatArray
    carrier: tuple[float, FloatArray, FloatArray]
    turns: FloatArray
    length: float
    mass_per_length: float
    EI: float
    GJ: float
    EA: float
    GA: float
    polar_inertia: float
    payload: float


def simulate(arm: BeamArm, drive: PrescribedMotion, *, elements: int, step: float, every: int) -> FloatArray:
    """Find the equilibrium of the first posture, then integrate; tool points (N, 3), m."""
    system = exu.SystemContainer()
    mbs = system.AddSystem()
    started = [False]
    tip = _build(mbs, arm, drive, elements, started)
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


def _build(mbs: Any, arm: BeamArm, drive: PrescribedMotion, elements: int, started: list[bool]) -> int:
    """Fill an empty system; the tool's node."""
    mass, inertia, com = arm.carrier
    node = mbs.AddNode(items.NodeRigidBodyEP(referenceCoordinates=[0, 0, 0, 1, 0, 0, 0]))
    body = mbs.AddObject(
        items.ObjectRigidBody(
            nodeNumber=node, physicsMass=mass, physicsInertia=list(inertia), physicsCenterOfMass=list(com)
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
            stiffness=arm.base_stiffness,
        )
    )
    section = exu.BeamSection()
    section.massPerLength = arm.mass_per_length
    section.inertia = arm.polar_inertia * np.diag([1.0, 0.5, 0.5])
    shear, axial = _STIFFER * arm.GA, _STIFFER * arm.EA
    section.stiffnessMatrix = np.diag([axial, shear, shear, arm.GJ, arm.EI, arm.EI])
    place, R, h = np.zeros(3), np.eye(3), arm.length / elements
    q = drive.states([0.0])[0][0]
    for joint, turn in enumerate(arm.turns):
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
        items.ObjectRigidBody(nodeNumber=node, physicsMass=arm.payload, physicsInertia=[1e-9] * 3 + [0.0] * 3)
    )
    _weigh(mbs, payload)
    return int(node)


def _angle(drive: PrescribedMotion, joint: int, started: list[bool]) -> Any:
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
