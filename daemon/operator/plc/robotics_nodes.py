"""Nodes of the OPC UA server with the names of OPC 40010-1 (OPC UA for Robotics 1.01).

The names stand in the namespaces of the specifications. Their types are not loaded: a client that
asks for ``MotionDeviceSystemType`` finds none.

    DeviceSet / linemate / MotionDevices / Robot / ParameterSet / OnPath
                                                 / Axes / A1.. / ParameterSet / ActualPosition
                         / Controllers / Daemon / TaskControls / Task / ParameterSet / ..
                         / SafetyStates
"""

from typing import Any, Final

from asyncua import Server, ua

from linemate.daemon.operator.plc.robotics_values import RoboticsValues
from linemate.protocol.stamped_samples import AXES

DI: Final = "http://opcfoundation.org/UA/DI/"
ROBOTICS: Final = "http://opcfoundation.org/UA/Robotics/"
_UNECE: Final = "http://www.opcfoundation.org/UA/units/un/cefact"
_UNITS: Final = {"rad": 4405297, "m": 5067858}  # codes C81 and MTR of UNECE


class RoboticsNodes:
    """The nodes of one daemon."""

    def __init__(self) -> None:
        self._variables: dict[str, Any] = {}
        self._axes: list[Any] = []
        self._written = RoboticsValues()

    async def make(self, server: Server, own: int) -> None:
        """Make the nodes.

        Args:
            own: index of the namespace of what is not named by the specifications.
        """
        di = await server.register_namespace(DI)
        robotics = await server.register_namespace(ROBOTICS)
        devices = await server.nodes.objects.add_object(di, "DeviceSet")
        system = await devices.add_object(own, "linemate")
        motion = await system.add_folder(robotics, "MotionDevices")
        robot = await motion.add_object(own, "Robot")
        parameters = await robot.add_object(di, "ParameterSet")
        axes = await robot.add_folder(robotics, "Axes")
        for name in AXES:
            axis = await axes.add_object(own, name)
            values = await axis.add_object(di, "ParameterSet")
            self._axes.append(await _position(values, robotics, "m" if name == "E1" else "rad"))
        controllers = await system.add_folder(robotics, "Controllers")
        controller = await controllers.add_object(own, "Daemon")
        controls = await controller.add_folder(robotics, "TaskControls")
        control = await controls.add_object(own, "Task")
        name = ua.LocalizedText("linemate")
        await control.add_property(di, "ComponentName", name)
        program = await control.add_object(di, "ParameterSet")
        await system.add_folder(robotics, "SafetyStates")
        add = self._variables
        add["on_path"] = await parameters.add_variable(robotics, "OnPath", False)
        add["program"] = await program.add_variable(robotics, "TaskProgramName", "")
        add["is_loaded"] = await program.add_variable(robotics, "TaskProgramLoaded", False)
        mode = ua.Variant(0, ua.VariantType.Int32)
        add["mode"] = await program.add_variable(robotics, "ExecutionMode", mode)

    async def write(self, values: RoboticsValues) -> None:
        """Write what has changed. Positions that are not known keep their last value."""
        before, self._written = self._written, values
        for name, node in self._variables.items():
            value = getattr(values, name)
            if value != getattr(before, name):
                kind = ua.VariantType.Int32 if name == "mode" else None
                await node.write_value(ua.Variant(value, kind))
        for node, position in zip(self._axes, values.positions, strict=False):
            await node.write_value(ua.Variant(float(position), ua.VariantType.Double))


async def _position(values: Any, index: int, unit: str) -> Any:
    """Return a new variable ActualPosition with its unit."""
    start = ua.Variant(float("nan"), ua.VariantType.Double)
    variable = await values.add_variable(index, "ActualPosition", start)
    text = ua.LocalizedText(unit)
    information = ua.EUInformation(_UNECE, _UNITS[unit], text, text)
    await variable.add_property(0, "EngineeringUnits", information)
    return variable
