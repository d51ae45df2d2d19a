"""Calls a phase's method for each message. The server has already checked that the sender may send this message."""

from collections.abc import Mapping

from avrgym.commands.vocabulary import CommandSource
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import (
    ExperimenterCommandName,
    ParticipantDisconnected,
    ReceivedMessage,
    StopMethod,
)
from avrgym.vr.session.interruptions import make_visibility_interruption
from avrgym.vr.session.phases import Phase

STOP_METHOD_BY_SOURCE: Mapping[CommandSource, StopMethod] = {"key": "key", "button": "button"}
"""Stop method of a command ``stop``, by the command's source."""


def handle_message(phase: Phase, message: ReceivedMessage) -> Phase:
    """Pass a message to a phase. Returns the next phase."""
    match message:
        case messages.TrackingFrameMessage():
            phase.on_tracking(message)
        case messages.Latency():
            phase.on_latency(message)
        case messages.FrameIntervals():
            phase.on_frame_intervals(message)
        case messages.SceneLoaded():
            phase.state.trial_worlds.mark_scene_shown(message.url)
        case messages.VrEntered():
            return phase.enter_vr()
        case messages.VrLeft():
            return phase.leave_vr()
        case ParticipantDisconnected():
            return phase.disconnect()
        case messages.VisibilityChanged():
            if phase.state.update_visibility(message.visibility):
                return phase.interrupt(make_visibility_interruption(phase.state.now_s, message.visibility))
        case messages.OriginReset():
            return phase.on_origin_reset()
        case messages.ParticipantReady():
            return phase.on_ready()
        case messages.BreakRequest():
            return phase.request_break("participant")
        case messages.PreferenceChangeRequest():
            return phase.change_preferences()
        case messages.RecalibrationRequest():
            return phase.recalibrate()
        case messages.Answer():
            return phase.answer(message)
        case messages.PreviousQuestionRequest():
            return phase.go_back()
        case messages.Stop():
            return phase.stop("participant", message.method)
        case messages.RobotCommand() | messages.OtherPersonRobotCommand():
            if message.name == "stop":
                return stop_by_command(phase, message.source)
            phase.command_robot(message.name, message.source)
        case messages.ParticipantBodyChoice():
            return phase.choose_body(message, "experimenter")
        case messages.BodyChoice():
            return phase.choose_body(message, "participant")
        case messages.TorsoHeightCorrection():
            return phase.correct_torso_height(message.torso_height_m)
        case messages.VelocityCommand():
            phase.apply_velocity_command(message)
        case messages.ControllerPoseCommand():
            phase.apply_controller_pose(message)
        case messages.DemonstratorDisconnected():
            phase.on_demonstrator_disconnected()
        case messages.ExperimenterCommand():
            return execute_experimenter_command(phase, message.name)
        case messages.OfferedTargets() | messages.TargetSelectionRequest():
            phase.state.participant_input.relay_selection(message, phase.state.send)
        case messages.FurniturePointMark():
            phase.state.mark_point(message.point)
        case messages.WatcherSceneLoaded() | messages.DemonstrationCommand():
            pass
        case messages.Hello() | messages.StateReceipt():
            phase.state.report_problem(
                f"a message of type {type(message).__name__} is ignored; a running session does not handle it"
            )
    return phase


def stop_by_command(phase: Phase, source: CommandSource) -> Phase:
    """Pass the command ``stop`` to a phase. Every source may stop the robot, even if the trial does not allow it."""
    if phase.can_be_stopped:
        phase.state.record_command("stop", source, effective=True)
    by = source if source == "caregiver" or source == "experimenter" else "participant"
    return phase.stop(by, STOP_METHOD_BY_SOURCE.get(source))


def execute_experimenter_command(phase: Phase, command: ExperimenterCommandName) -> Phase:
    """Pass a command of the experimenter to a phase. Returns the next phase."""
    match command:
        case "stop":
            return phase.stop("experimenter")
        case "pause":
            return phase.pause()
        case "continue":
            return phase.resume()
        case "repeat":
            return phase.repeat()
        case "skip":
            return phase.skip()
        case "end":
            return phase.end_session()
        case "recalibrate":
            return phase.repeat_calibration()
        case "break":
            return phase.request_break("experimenter")
