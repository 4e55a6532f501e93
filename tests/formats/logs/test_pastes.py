"""Every form of paste: the bytes come back as they were, or one line says why they cannot."""

from __future__ import annotations

import io
import shutil
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import FileError, FteSniffError, InputTextError
from fte_sniff.formats.logs.hex_log import HexLog
from fte_sniff.protocol.spec import DEFAULT_BAUD, byte_time_ns
from tests.examples import examples
from tests.formats.forms import FORMS, bytes_in, bytes_of_text

CONTROL = bytes.fromhex("AA010103E800000000EE")
FEEDBACK = bytes.fromhex("55010103E80000000FEE")
SESSION = (CONTROL + FEEDBACK) * 7
STREAMS = st.binary(min_size=1, max_size=90) | st.lists(
    st.sampled_from([CONTROL, FEEDBACK, b"\x00", b" ", b"AA ", b"..", b"|", b"#//*"]),
    min_size=1,
    max_size=12,
).map(b"".join)


def read(text: str, encoding: str = "utf-8") -> tuple[bytes, list[str]]:
    log = HexLog.of_stream(io.BytesIO(text.encode(encoding)), "f")
    return b"".join(chunk.data for chunk in log), log.doubts


@pytest.mark.parametrize("name", FORMS)
def test_a_session_in_each_form(name: str) -> None:
    form = FORMS[name]
    assert read(form(SESSION))[0] == bytes_in(form, SESSION)
    assert read(form(SESSION).replace("\n", "\r\n"))[0] == bytes_in(form, SESSION)


@pytest.mark.parametrize("name", FORMS)
@given(data=STREAMS)
def test_any_stream_in_each_form_comes_back(name: str, data: bytes) -> None:
    form = FORMS[name]
    assert bytes_of_text(form(data)) == bytes_in(form, data)


@pytest.mark.parametrize(
    "command",
    [
        ["xxd"],
        ["xxd", "-g1"],
        ["xxd", "-c7", "-u"],
        ["xxd", "-i"],
        ["xxd", "-p"],
        ["hexdump", "-C"],
        ["od", "-A", "x", "-t", "x1z"],
        ["od", "-t", "x1"],
        ["od", "-A", "d", "-v", "-t", "x1"],
        ["od", "-A", "n", "-t", "x1"],
        ["od", "-A", "n", "-t", "u1"],
        ["od", "-A", "n", "-t", "d1"],
    ],
    ids=" ".join,
)
def test_what_the_programs_really_write(command: list[str]) -> None:
    if shutil.which(command[0]) is None:
        pytest.skip(f"there is no {command[0]} here")
    done = subprocess.run(command, input=SESSION, capture_output=True, check=True, timeout=60)
    assert read(done.stdout.decode())[0] == SESSION


@pytest.mark.parametrize("command", ["hexdump -C", "od -t x1", "od -A x -t x1z", "od -A d -t x1"])
@given(zeros=st.integers(0, 400))
@examples(20)
def test_lines_left_out_of_a_dump_are_put_back_or_it_is_refused(command: str, zeros: int) -> None:
    if shutil.which(command.split()[0]) is None:
        pytest.skip(f"there is no {command} here")
    stream = CONTROL + bytes(zeros) + FEEDBACK
    done = subprocess.run(
        command.split(), input=stream, capture_output=True, check=True, timeout=30
    )
    try:
        assert read(done.stdout.decode())[0] == stream
    except InputTextError as error:
        # od's addresses are octal or decimal, and some are both.
        assert command.startswith("od -")
        assert "how many lines * stands for; dump again with -v" in str(error)  # noqa: PT017


@pytest.mark.parametrize("count", [1000, 1001, 1002, 1500])
def test_lines_that_wait_long_for_one_that_decides_come_once(count: int) -> None:
    assert bytes_of_text("12 34 56\n" * count) == bytes.fromhex("123456") * count
    assert bytes_of_text("12 34 56\n" * count + "AA") == bytes.fromhex("123456") * count + b"\xaa"


CUT = (
    *("xxd", "xxd_bytes", "hexdump", "od_text", "wireshark", "wireshark_stream", "hexyl", "spy"),
    *("python_bytes", "sscom", "labelled", "ros", "logging"),
)


@pytest.mark.parametrize("name", CUT)
def test_what_is_cut_anywhere_gives_its_first_bytes_or_is_refused(name: str) -> None:
    text = FORMS[name](SESSION[:64])
    # Of less than a line, nothing shows what it is.
    for cut in range(text.find("\n") + 1 or len("data = b'"), len(text)):
        try:
            found = read(text[:cut])[0]
        except FteSniffError:
            continue
        assert SESSION.startswith(found), text[:cut]


@pytest.mark.parametrize("command", ["hexdump", "od -x", "xxd -e", "od -A x -t x2z"])
def test_words_in_the_order_of_a_machine_are_refused(command: str) -> None:
    if shutil.which(command.split()[0]) is None:
        pytest.skip(f"there is no {command} here")
    done = subprocess.run(
        command.split(), input=SESSION, capture_output=True, check=True, timeout=30
    )
    with pytest.raises(InputTextError, match=r"the machine's order.* hexdump -C"):
        read(done.stdout.decode())


REPEATED = "00000000  aa 01 01 03 e8 00 00 00  00 ee 55 01 01 03 e8 00  |..........U.....|\n*\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0010: AA 01 01 03", "line 1: 0010 may be an address or bytes"),
        ("00000000 AA 01 01 03", "line 1: 00000000 may be an address or bytes"),
        ("0000 AA 01 01 03", "line 1: 0000 may be an address or bytes"),
        ("12: AA 01 01 03", "line 1: 12: may be a line's number or a byte"),
        ("[3] AA 01 01 03", "line 1: [3] may be a line's number or a byte"),
        ("{0xAA, 1, 10, 0xE8}", "line 1: 10 may be hex or decimal among numbers with 0x"),
        ("30 31 32 33  0123", "line 1: 0123 may be bytes, or the text of those before it"),
        ("0000: AA 01  ..\n0002: 41 42  xy", "line 2: behind the address 0002, bytes and text do"),
        ("AA 01 01 03 E", "'E' has no second digit, as others have, line 1, column 13"),
        ("A A 0 1 0 1", "'A' may be a byte or half of one, line 1, column 1"),
        ("AA 01 ... EE", "stands where bytes seem to have been left out"),
        ("[170, 1, 256]", "'0' has no second digit"),
        ("[170, 1]\n[AA, 2]", "'A' is in no decimal number, as those before it are, line 2"),
        ("[-86, 1, -200]", "line 1, column 10: -200 is no byte"),
        (r'"\xAA\x0101"', "'0' stands behind a whole escape"),
        ("qgEBA+gAAAAA7g==", "base64 has it"),
        ("battery: 55", "'t' is no hex digit"),
        ("  can0  123   [8]  AA 01 01 03", "'n' is no hex digit"),
        ("data:\n- 170\n- 85\n- '...'", "stands where bytes seem to have been left out"),
        (r"b'\xaa' b'\x01\x01", "'b' starts a bytes literal that does not end on its line"),
        (
            "0000   55 01 01 03 e8 00 00 00 00 ee aa 0101 03 e8 00\n0010   00 00 00 ee",
            "line 1: its bytes do not fit its address, which the line below goes on from",
        ),
        (REPEATED[:-2] + "0000002a", "line 2: the dump ends at address 0000002a, but lines before"),
        (REPEATED[:-2] + "000000", "line 2: 000000 may be the dump's next address cut short"),
        (REPEATED[:-2] + "00", "line 2: 00 may be the dump's next address cut short"),
        (REPEATED + "0000", "line 3: 0000 may be the dump's next address cut short"),
        ("33 32" + " " * 45 + "32", "line 1: 32 may be bytes, or the text of those before it"),
        (REPEATED + "fffffffffffffff0", "line 3: * stands for too many bytes; dump with -v"),
        (REPEATED + "40000000", "line 3: * stands for too many bytes; dump with -v"),
    ],
)
def test_what_cannot_be_told_is_refused(text: str, said: str) -> None:
    with pytest.raises(InputTextError) as caught:
        bytes_of_text(text)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "data", "note"),
    [
        ("10 20 30", "10 20 30", "nothing tells whether the numbers are hex or decimal"),
        ("[170, 1, 1]", "AA 01 01", "line 1: the numbers are read as decimal"),
        ("170 85\n171 86", "AA 55 AB 56", "line 1: the numbers are read as decimal"),
        ("1, 2\n3, 170", "01 02 03 AA", "line 2: the numbers are read as decimal"),
        ("0000: AA 01 01", "AA 01 01", "line 1: 0000 is taken for an address"),
        ("1 AA 01\n2 01 03", "AA 01 01 03", "line 1: 1 and the numbers below it count lines"),
        (
            "00000000: aa01  ..\n00000010: 0103  ..",
            "AA 01 01 03",
            "line 2: the dump goes on at address 00000010",
        ),
    ],
)
def test_what_is_doubtful_is_told(text: str, data: str, note: str) -> None:
    found, notes = read(text)
    assert found == bytes.fromhex(data)
    assert len(notes) == 1
    assert note in notes[0]


@pytest.mark.parametrize(
    ("text", "data"),
    [
        ("AA01 0103 E800 0000 00EE\n" * 3, "AA01 0103 E800 0000 00EE" * 3),
        ("AA010103 E8 00\n0000 00EE", "AA0101 03E8 0000 0000EE"),
        ("0000 0000 00EE\n0000 0000 00EE", "0000 0000 00EE 0000 0000 00EE"),
        ("01 03 E8\n02 03 E8\n03 03 E8", "0103E8 0203E8 0303E8"),
        ("10\tAA\n11\tAB", "10AA 11AB"),
        ("[55][01]", "55 01"),
        ("AA.01.02", "AA 01 02"),
        ("1 2\nAA 3", "01 02 AA 03"),
        ("1 AA", "01 AA"),
        ("0000: 30 30 00\n0003: AA 01 01", "30 30 00 AA 01 01"),
        ("00000000: 3d7b 685f d896                           ={h_..", "3D 7B 68 5F D8 96"),
    ],
)
def test_bytes_are_not_taken_for_addresses_or_numbers(text: str, data: str) -> None:
    assert read(text) == (bytes.fromhex(data), [])


@given(st.text(alphabet="0123456789ABCDEFabcdefx .,:*|#/-[]'\"\\\n\trTxX收发年", max_size=80))
def test_any_text_is_bytes_or_one_clear_line(text: str) -> None:
    outcome = "line"
    try:
        bytes_of_text(text)
    except InputTextError as error:
        outcome = str(error)
    assert "line" in outcome
    assert "\n" not in outcome


ENCODINGS = ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "gb18030"]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", ["sscom", "xcom", "hexdump", "full_width", "fenced"])
def test_logs_in_every_encoding(encoding: str, name: str) -> None:
    if name == "full_width":
        # Nothing in it but full-width letters, which no zeros stand between.
        encoding = encoding.removesuffix("-le").removesuffix("-be")
    assert read(FORMS[name](SESSION), encoding)[0] == SESSION


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-8", "gb18030"])
def test_a_stream_that_comes_byte_by_byte(encoding: str) -> None:
    class Slow(io.BytesIO):
        def read1(self, size: int | None = -1, /) -> bytes:
            return self.read(1)

    text = FORMS["sscom"](SESSION)
    log = HexLog.of_stream(Slow(text.encode(encoding)), "f")
    assert b"".join(chunk.data for chunk in log) == SESSION


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (SESSION, "add --input raw"),
        (b"AA 01 \x81\xff 03\n", "line 1 is text in neither UTF-8, UTF-16 nor GBK (byte"),
    ],
)
def test_what_is_no_text_is_told_with_the_way_out(content: bytes, said: str) -> None:
    with pytest.raises(FteSniffError) as caught:
        list(HexLog.of_stream(io.BytesIO(content), "f"))
    assert said in str(caught.value)
    assert "--input raw" in str(caught.value)


FRAME = "AA 02 02 03 E8 00 00 27 10 EE"


@pytest.mark.parametrize(
    "text",
    [
        "0x20000000:\t0xaa\t0x02\t0x02\t0x03\t0xe8\t0x00\t0x00\t0x27\n0x20000008:\t0x10\t0xee",
        "0x20000000 <rx>:\t0xaa\t0x02\t0x02\t0x03\t0xe8\n"
        "0x20000005 <rx+5>:\t0x00\t0x00\t0x27 0x10 0xee",
        f"2026-01-31 {FRAME}",
        f"14:03 {FRAME}",
        "14:03 AA 02 02 03 E8\n14:04 00 00 27 10 EE",
        "14:03:22 AA 02 02 03 E8\n14:03:23 00 00 27 10 EE",
        f"1706702602 {FRAME}",
        f"1706702602.123 {FRAME}",
        f"Rx:10  {FRAME}",
        "0b10101010 0b00000010 0b00000010 0b00000011\n E8 00 00 27 10 EE",
    ],
)
def test_times_addresses_and_counts_in_front_are_no_bytes(text: str) -> None:
    assert read(text) == (bytes.fromhex(FRAME), [])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0x20000000: 0xAA 0x02", "line 1: 20000000 may be an address or bytes"),
        (f"Rx:11  {FRAME}", "line 1: 11 may be a byte, or a count"),
        ("0b10101010", "begins eight bits or five bytes"),
        ("0b10101010 AA 02", "begins eight bits or five bytes"),
        ("14:03 01 02\n14:03 02 03", "line 1: 14:03 stands before the bytes"),
        ("\n1234 01 02\n5678 02 03", "line 2: 1234 stands before the bytes"),
        ("7 AA 01\n7 AA 01", "line 1: 7 stands before the bytes"),
        ("0x0007 0xAA, 0x01\n0x0007 0xAA, 0x01", "line 1: 0x0007 stands before the bytes"),
    ],
)
def test_what_is_unlike_the_bytes_behind_it_on_every_line_is_refused(text: str, said: str) -> None:
    with pytest.raises(InputTextError) as caught:
        bytes_of_text(text)
    assert said in str(caught.value)


def test_what_is_unlike_the_bytes_behind_it_on_the_only_line_is_told() -> None:
    assert read("1234 01 02") == (
        bytes.fromhex("12340102"),
        ["line 1: 1234 at its front is read as bytes"],
    )


PREFIXED = ["0x" + pair for pair in FRAME.split()]
LIST = ", ".join(PREFIXED)
NUMBERS = ", ".join(str(byte) for byte in bytes.fromhex(FRAME))
ESCAPED = "".join(f"\\x{pair.lower()}" for pair in FRAME.split())


@pytest.mark.parametrize(
    "text",
    [
        f"uint8_t f[2][10] = {{{LIST}}};",
        f"uint8_t f[1][10] = {{\n  {{{LIST}}}\n}};",
        "; ".join(f"buf[{place}] = {byte}" for place, byte in enumerate(PREFIXED)) + ";",
        "\n".join(f"msg->buf[{place}] = {byte};" for place, byte in enumerate(PREFIXED)),
        "，".join(f"DATA[{place}] ={byte}" for place, byte in enumerate(PREFIXED)),
        "{" + ", ".join(f"{byte}u" for byte in PREFIXED) + "}",
        "{" + ", ".join(f"{byte}U" for byte in PREFIXED) + "}",
        "{" + ", ".join(f"(uint8_t){byte}" for byte in PREFIXED) + "}",
        f"static const unsigned char x[] PROGMEM = {{{LIST}}};",
        f"#define CMD {{{LIST}}}",
        f'bytes.fromhex("{FRAME}")',
        f"ser.write(b'{ESCAPED}')",
        f"ser.write(bytes([{LIST}]))",
        f"array([{NUMBERS}], dtype=uint8)",
        f"np.array([{NUMBERS}], dtype=np.uint8)",
        f"[]byte{{{LIST}}}",
        f"x := []byte{{{LIST}}}",
        f"[{LIST.replace(',', 'u8,', 1)}]",
        f"let f: [u8; 10] = [{LIST}];",
        "new byte[]{" + ", ".join(f"(byte){byte}" for byte in PREFIXED) + "}",
        f'{{"data": [{NUMBERS}]}}',
        ", ".join(("0" if pair[0] > "9" else "") + pair + "h" for pair in FRAME.split()),
        f"unsigned char foo[] = {{\n  {LIST}\n}};\nunsigned int foo_len = 10;",
        f"\x1b[32m{FRAME[:8]}\x1b[0m{FRAME[8:]}",
    ],
)
def test_bytes_in_source_code(text: str) -> None:
    assert read(text)[0] == bytes.fromhex(FRAME)


@pytest.mark.parametrize(
    "text",
    [
        "buf[1] = 0xAA; buf[0] = 0x02;",
        "buf[0] = 10;",
        "int speed = 10;",
        "#define COUNT 10\nspeed[2] = {x}",
    ],
)
def test_source_code_that_says_more_than_bytes_is_refused(text: str) -> None:
    with pytest.raises(InputTextError):
        bytes_of_text(text)


def test_rows_as_json_lines_are_their_bytes() -> None:
    text = (
        '{"time": "2026-01-31T12:00:00.000000000Z", "port": "a", "offset": 0, "faults": [], '
        f'"raw": "{FRAME.replace(" ", "")}"}}\n'
    )
    log = HexLog.of_stream(io.BytesIO(text.replace(": ", ":").encode()), "f")
    (chunk,) = log
    assert chunk.data == bytes.fromhex(FRAME)
    assert chunk.t_ns == 1_769_860_800 * 10**9 + 10 * byte_time_ns(DEFAULT_BAUD)
    assert bytes_of_text(text * 2) == chunk.data * 2


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_a_file_that_ends_within_a_character(encoding: str) -> None:
    content = "AA 01 01 03\n55 01".encode(encoding)
    with pytest.raises(FileError, match=r"f: ends within a character \(UTF-.*cut short"):
        list(HexLog.of_stream(io.BytesIO(content[:-1]), "f"))
