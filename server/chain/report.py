"""FrameResult -> messages: the one conversion. What is published is what is recorded is what is reviewed."""

from collections.abc import Iterator

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry, set_report_pose, set_vector, to_bytes
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Message, RobotPose
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.chain.smooth import SmoothedPose
from asterism.server.pose.solve import OnSurface, PoseEstimate


def report(frame: Frame, result: FrameResult, rig: Rig, solved_ns: int) -> Iterator[Message]:
    """The messages of one frame: odometry of every located robot, then the frame report; each is encoded when it is
    asked for, so that no pose waits for what comes behind it.

    ``solved_ns`` is when the poses were known, ns since the Unix epoch. They are stamped when they go out
    (`codec.stamped`).
    """
    for robot_id, answer in result.answers.items():
        if isinstance(answer, PoseEstimate):
            told = RobotPose(
                robot=robot_id,
                frame_id=rig.parent_frame,
                pose=answer.pose,
                covariance=answer.covariance,
                state=answer.state,
                leds=len(answer.leds),
                rms_px=answer.rms_px,
                sequence=result.index,
                exposed_ns=result.exposed_ns,
                published_ns=0,
                session=frame.session,
                smoothed_by=answer.smoothed_by,
                extrapolated=answer.extrapolated,
                velocity=answer.velocity if isinstance(answer, SmoothedPose) else None,
                standing=answer.surface.standing if answer.surface is not None else "",
            )
            key = keys.odometry(rig.camera.name, robot_id)
            yield Message(key, ODOMETRY, encode_odometry(told), result.exposed_ns, 0, result.index)
    payload = to_bytes(frame_report(frame, result, rig, solved_ns))
    key = keys.frame(rig.camera.name)
    yield Message(key, FRAME_REPORT, payload, result.exposed_ns, 0, result.index)


def frame_report(frame: Frame, result: FrameResult, rig: Rig, solved_ns: int) -> "pb.FrameReport":
    """Everything that was seen and concluded in one frame."""
    message = pb.FrameReport(
        sequence=result.index,
        exposed_ns=result.exposed_ns,
        arrived_ns=frame.arrived_ns or result.exposed_ns,
        solved_ns=solved_ns,
        session=frame.session,
        clock=frame.clock,
        frame_id=rig.parent_frame,
    )
    message.learned.led_misfit.extend(result.learned.tolist())
    if result.place is not None:
        set_report_pose(message.camera.pose, result.place.T_world_camera)
        message.camera.covariance.extend(result.place.covariance.ravel().tolist())
        message.camera.noise.extend(result.place.noise.ravel().tolist())
        message.camera.seen_ns = result.place.seen_ns
    blobs, spots = result.blobs, message.spots
    spots.x.extend(blobs.centres_px[:, 0].tolist())
    spots.y.extend(blobs.centres_px[:, 1].tolist())
    spots.covariance_xx.extend(blobs.covariances_px2[:, 0].tolist())
    spots.covariance_xy.extend(blobs.covariances_px2[:, 1].tolist())
    spots.covariance_yy.extend(blobs.covariances_px2[:, 2].tolist())
    spots.brightness.extend(blobs.heights.tolist())
    spots.radius.extend(blobs.radii_px.tolist())
    spots.fate.extend(blobs.fates.tolist())
    spots.robot.extend(blobs.robots.tolist())
    spots.led.extend(blobs.leds.tolist())
    for robot in rig.robots:
        answer = result.answers[robot.id]
        entry = message.robots.add(id=robot.id, state=pb.State.Value(answer.state))
        if not isinstance(answer, PoseEstimate):
            entry.reason = answer.reason
            continue
        set_report_pose(entry.pose, answer.pose)
        entry.covariance.extend(answer.covariance.ravel().tolist())
        entry.leds = len(answer.leds)
        entry.rms_px = answer.rms_px
        entry.smoothed_by = answer.smoothed_by
        entry.extrapolated = answer.extrapolated
        if isinstance(answer, SmoothedPose) and answer.velocity is not None:
            set_vector(entry.velocity.linear, answer.velocity.linear)
            set_vector(entry.velocity.angular, answer.velocity.angular)
            entry.velocity.covariance.extend(answer.velocity.covariance.ravel().tolist())
        entry.led.extend(answer.leds)
        entry.spot.extend(answer.spots)
        entry.residual_x.extend(answer.residuals_px[:, 0].tolist())
        entry.residual_y.extend(answer.residuals_px[:, 1].tolist())
        if answer.alternative is not None:
            set_report_pose(entry.alternative.pose, answer.alternative.pose)
            entry.alternative.odds = answer.alternative.odds
        if answer.surface is not None:
            entry.surface.CopyFrom(surface_report(answer.surface))
        for name, point in robot.points.items():
            set_vector(entry.points[name], answer.pose.map(point))
    return message


def surface_report(surface: OnSurface) -> "pb.OnSurface":
    """How a robot stands, as a message."""
    told = pb.OnSurface(
        standing=surface.standing,
        reason=surface.reason,
        off_m=surface.off_m,
        off_sigma_m=surface.off_sigma_m,
        tilt_off_rad=surface.tilt_off_rad,
        tilt_off_sigma_rad=surface.tilt_off_sigma_rad,
    )
    if surface.without is not None and surface.without_covariance is not None:
        set_report_pose(told.without, surface.without)
        told.without_covariance.extend(surface.without_covariance.ravel().tolist())
    if surface.without_alternative is not None:
        set_report_pose(told.without_alternative.pose, surface.without_alternative.pose)
        told.without_alternative.odds = surface.without_alternative.odds
    return told
