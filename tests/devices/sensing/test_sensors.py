"""The sensors' pure halves: readings in, bytes out."""

import pytest

from linemate.protocol.sensors.camera_codec import CameraDecoder
from linemate.protocol.sensors.distance import DistanceDecoder, DistanceEncoder
from linemate.protocol.sensors.wrench import WrenchError, make_decoder, make_host
from linemate.simulators.devices.sensing.camera_sender import CameraSender
from linemate.simulators.devices.sensing.can_sensor import CanSensor
from linemate.simulators.devices.sensing.force_torque import ForceTorqueSensor


def test_a_mounted_distance_sensor_reads_its_distance_to_the_unit() -> None:
    sensor = CanSensor(DistanceEncoder(), mount=1.0)
    frame = sensor.frame(-0.25)
    assert frame is not None
    sample = DistanceDecoder().decode(frame.can_id, frame.data, 5, frame.extended)
    assert sample is not None
    assert sample.position == pytest.approx(0.75, abs=1e-4)


def test_a_target_out_of_range_makes_the_sensor_silent() -> None:
    sensor = CanSensor(DistanceEncoder())
    assert sensor.frame(-0.01) is None
    assert (sensor.sent, sensor.out_of_range) == (0, 1)


def test_the_cameras_clock_is_its_own() -> None:
    sender = CameraSender(clock_offset_ns=10**12)
    decoder = CameraDecoder()
    for number in range(3):
        now_ns = number * 25_000_000
        data = sender.datagram(
            (1, 2, 3), (1, 0, 0, 0), None, exposure_ns=now_ns - 90_000_000, sent_ns=now_ns
        )
        sample = decoder.feed(data, now_ns + 1_000_000)
        assert sample.sequence == number
        # The shortest transit is taken for the clocks' difference, so it is in the offset.
        assert sample.exposure_ns == now_ns - 89_000_000


@pytest.mark.parametrize("device", ["bota", "robotiq-ft300"])
def test_a_force_torque_sensor_streams_after_its_dialogue(device: str) -> None:
    sensor, host, decoder = ForceTorqueSensor(device), make_host(device), make_decoder(device)
    sensor.boot()
    sent, now_ns, stream = host.begin(0).send, 0, b""
    while not host.running and now_ns < 20:
        output = host.feed(sensor.feed(sent), now_ns)
        sent, stream, now_ns = output.send, output.stream, now_ns + 1
    assert sensor.streaming
    data = stream + sensor.frame((1, 2, 3), (0.1, 0.2, 0.3), 77)
    (sample,) = decoder.feed(host.feed(data, now_ns).stream, 9)
    assert sample.force == pytest.approx((1, 2, 3))
    assert sample.stamp_ns == 9


def test_a_sensor_that_is_being_configured_withholds_its_readings() -> None:
    sensor = ForceTorqueSensor("bota")
    sensor.boot()
    sensor.feed(b"C")
    assert sensor.frame((1, 2, 3), (0, 0, 0), 1) == b""
    assert sensor.withheld == 1


def test_an_unknown_device_is_named() -> None:
    with pytest.raises(WrenchError, match="acme"):
        ForceTorqueSensor("acme")
