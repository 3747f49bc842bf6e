"""A scene as Foxglove's own messages, in Protobuf: what the bodies look like, and where they are.

The plane of a scene stands upright: u is x, v is z, and an angle turns about -y.
"""

import math
from collections.abc import Sequence

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from otc_dist.scenes.scene import Body, Capsule, Colour, Scene, View
from otc_dist.transitions import Float64

WORLD = "world"
VIEW = "view"  # the frame that the layout's camera follows
LEVELS = 20  # steps in which a body's level shows
_FAINT = 0.35  # opacity of places; no body that is there is fainter
_GROUND = (-10, 200)  # m
_MARK = 0.05  # m: half the length of the marks at every metre
# Of positions in m, and of quaternions: a millimetre, and a tenth of a degree. A power of two, so
# that the low bytes of a double are zeros, and a step takes a third of the room.
_FINEST = 2.0**-10


def scene_update(scene: Scene, levels: Sequence[int], log_time: int) -> SceneUpdate:
    """All that there is, whole, as of `log_time`, ns since the epoch.

    Args:
        levels: of each body: `LEVELS`, it is whole, to 0: it is gone.
    """
    update = SceneUpdate(entities=[_ground(scene.view)])
    for body, level in zip(scene.bodies, levels, strict=True):
        if level > 0:
            opacity = _FAINT + (1 - _FAINT) * level / LEVELS if body.solid else _FAINT
            update.entities.append(_entity(body, _colour(body.colour, opacity)))
        else:  # who plays on has it from before
            update.deletions.add(type=SceneEntityDeletion.MATCHING_ID, id=body.name)
    for dated in (*update.entities, *update.deletions):
        dated.timestamp.FromNanoseconds(log_time)
    return update


def _ground(view: View) -> SceneEntity:
    """The walls of the arena, or the ground with a mark at every metre."""
    if view.follows is None:
        kind, points = LinePrimitive.LINE_LOOP, [*view.outline]
    else:
        first, last = _GROUND
        kind, points = LinePrimitive.LINE_LIST, [(float(first), 0.0), (float(last), 0.0)]
        for metre in range(first, last + 1):
            points += [(float(metre), 0.0), (float(metre), -_MARK)]
    line = LinePrimitive(
        type=kind,
        pose=_pose(0.0, 0.0, 0.0),
        thickness=2,
        scale_invariant=True,
        points=[Point3(x=x, z=z) for x, z in points],
        color=Color(r=0.5, g=0.5, b=0.5, a=1),
    )
    return SceneEntity(id="ground", frame_id=WORLD, frame_locked=True, lines=[line])


def _entity(body: Body, colour: Color) -> SceneEntity:
    entity = SceneEntity(id=body.name, frame_id=body.name, frame_locked=True)
    for capsule in body.capsules:
        width = 2 * capsule.radius
        size = Vector3(x=width, y=width, z=width)
        for x, z in dict.fromkeys((capsule.start, capsule.end)):
            entity.spheres.append(SpherePrimitive(pose=_pose(x, z, 0.0), size=size, color=colour))
        if capsule.start != capsule.end:
            entity.cylinders.append(_cylinder(capsule, colour))
    return entity


def _cylinder(capsule: Capsule, colour: Color) -> CylinderPrimitive:
    """Its axis is its own z, which has to be turned about y."""
    (x, z), (to_x, to_z) = capsule.start, capsule.end
    width = 2 * capsule.radius
    return CylinderPrimitive(
        pose=_pose((x + to_x) / 2, (z + to_z) / 2, math.atan2(to_x - x, to_z - z)),
        size=Vector3(x=width, y=width, z=math.hypot(to_x - x, to_z - z)),
        bottom_scale=1,
        top_scale=1,
        color=colour,
    )


def _pose(x: float, z: float, about_y: float) -> Pose:
    turned = Quaternion(y=math.sin(about_y / 2), w=math.cos(about_y / 2))
    return Pose(position=Vector3(x=x, z=z), orientation=turned)


def _colour(colour: Colour, opacity: float) -> Color:
    r, g, b = (part / 255 for part in colour)
    return Color(r=r, g=g, b=b, a=opacity)


class Placing:
    """Where the frames of a scene's bodies are, and `VIEW`, which a camera follows."""

    def __init__(self, scene: Scene) -> None:
        self._view = scene.view
        self._names = (*(body.name for body in scene.bodies), VIEW)

    def frames(self, poses: Float64) -> Float64:
        """The frames (T, B + 1, 4) of B bodies' poses (T, B, 3): x, z, the rotation's y and w."""
        view = np.zeros((len(poses), 1, 3))
        follows = self._view.follows
        view[:, 0, 0] = self._view.centre[0] if follows is None else poses[:, follows, 0]
        view[:, 0, 1] = self._view.centre[1]
        u, v, angle = np.moveaxis(np.concatenate((poses, view), axis=1), 2, 0)
        # In the upright plane, seen from -y, counterclockwise is about -y.
        frames = np.stack((u, v, -np.sin(angle / 2), np.cos(angle / 2)), axis=2)
        return np.rint(frames / _FINEST) * _FINEST + 0.0  # no negative zeros, which take room

    def transforms(self, frames: Sequence[Sequence[float]], log_time: int) -> FrameTransforms:
        """Those of one step, at `log_time`, ns since the epoch; none for a body that is nowhere."""
        update = FrameTransforms()
        seconds, rest = divmod(log_time, 10**9)
        for name, (x, z, y, w) in zip(self._names, frames, strict=True):
            if math.isfinite(x + z + y + w):
                # Field by field: twice as fast as messages made for it.
                frame = update.transforms.add(parent_frame_id=WORLD, child_frame_id=name)
                frame.timestamp.seconds, frame.timestamp.nanos = seconds, rest
                frame.translation.x, frame.translation.z = x, z
                frame.rotation.y, frame.rotation.w = y, w
        return update
