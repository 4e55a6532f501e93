from fte_sniff.protocol import KINDS, MOTORS, Damage, Fault, Frame, encode
from fte_sniff.recording.messages.schema import TOPICS, topic_of


def _frame(kind_name: str, num: int = 1, faults: tuple[Fault, ...] = ()) -> Frame:
    kind = next(kind for kind in KINDS if kind.name == kind_name)
    values = {field.name: 1 for field in kind.fields}
    raw = bytearray(encode(kind, values))
    raw[2] = num
    return Frame("port", 0, bytes(raw), 0, faults)


def test_the_topics_are_those_that_users_know() -> None:
    assert [topic.name for topic in TOPICS] == [
        "/fte/control/reset",
        "/fte/control/motor1",
        "/fte/control/motor2",
        "/fte/control/motor3",
        "/fte/control/motor4",
        "/fte/control/chassis",
        "/fte/feedback/motor1",
        "/fte/feedback/motor2",
        "/fte/feedback/motor3",
        "/fte/feedback/motor4",
        "/fte/malformed",
        "/fte/port",
    ]


def test_each_kind_and_motor_has_its_topic() -> None:
    for motor in MOTORS:
        for name in ("speed", "position"):
            assert topic_of(_frame(name, motor)).name == f"/fte/control/motor{motor}"
            assert topic_of(_frame(f"{name}_feedback", motor)).name == f"/fte/feedback/motor{motor}"
    for num in (0, 1, 255):
        assert topic_of(_frame("mecanum", num)).name == "/fte/control/chassis"
        assert topic_of(_frame("reset", num)).name == "/fte/control/reset"


def test_a_suspect_frame_stays_with_its_kind() -> None:
    suspect = _frame("speed", 2, (Fault.RESERVED_NONZERO, Fault.AMBIGUOUS))
    assert topic_of(suspect).name == "/fte/control/motor2"


def test_what_cannot_be_believed_is_kept_apart() -> None:
    unknown = Frame("port", 0, bytes.fromhex("AA7701000000000000EE"), 0, (Fault.UNKNOWN_CMD,))
    rows = [
        unknown,
        _frame("speed", 9, (Fault.BAD_MOTOR,)),
        _frame("speed", 1, (Fault.BAD_TAIL,)),
        _frame("speed", 9),
        Damage("port", 0, b"\x01", 0, (Fault.LINE_ERROR,)),
        Damage("port", 0, unknown.raw, 0, (Fault.NOISE,)),
    ]
    assert {topic_of(row).name for row in rows} == {"/fte/malformed"}
