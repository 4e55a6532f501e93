"""The rules for URL handlers, for each scheme; the simulated port."""

import itertools
import time
from collections.abc import Callable
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import NamedTuple

import pytest
import serial

from fte_sniff.capture import url_handlers
from fte_sniff.capture.serial_port import open_port, reader_of, writer_of
from fte_sniff.capture.simulation import Simulation, SimulationParameters
from fte_sniff.capture.url_handlers import NETWORK, SCHEMES
from fte_sniff.errors import PortError
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.spec import KIND_BY_NAME, encode
from tests.beside import server_socket
from tests.rfc2217_server import serving
from tests.support.columns import fed
from tests.waiting import BOUND_S

DATA = bytes(range(256))


class Line(NamedTuple):
    """A line behind a URL."""

    url: str
    data: bytes
    """What comes on it."""
    begin: Callable[[], object]
    """Send the data; the port is open."""
    lose: Callable[[], object]
    """End the line; all data has come."""
    silent: str
    """The URL of a line, perhaps of this one, on which nothing comes before `begin`."""


@contextmanager
def simulated_line(_pty):
    data = b"".join(item.data for item in Simulation(SimulationParameters(frames=5)))
    nothing = tuple
    yield Line("sim://?frames=5", data, nothing, nothing, "sim://?host=off&wire=control")


@contextmanager
def line_over_socket(_pty):
    clients = []

    def begin():
        clients.append(listening.accept()[0])
        clients[0].sendall(DATA)

    with server_socket() as listening:
        url = f"socket://127.0.0.1:{listening.getsockname()[1]}"
        yield Line(url, DATA, begin, lambda: clients[0].close(), url)


@contextmanager
def line_over_rfc2217(pty):
    with serving(pty.device) as server:
        yield Line(server.url, DATA, lambda: pty.send(DATA), server.hang_up, server.url)


LINES = {"rfc2217": line_over_rfc2217, "sim": simulated_line, "socket": line_over_socket}
"""By scheme, a line for the tests of the rules."""


@pytest.fixture(params=LINES)
def line(request, pty):
    with LINES[request.param](pty) as made:
        yield made


def test_each_scheme_is_tested():
    modules = Path(url_handlers.__file__).parent.glob("protocol_*.py")
    assert sorted(LINES) == sorted(path.stem.removeprefix("protocol_") for path in modules)
    found = set[str]()
    for package in map(import_module, serial.protocol_handler_packages):
        found |= {one.name for one in iter_modules(package.__path__)}
    assert {name for name in found if name.startswith("protocol_")} == {
        f"protocol_{scheme}" for scheme in SCHEMES
    }
    assert set(NETWORK) <= set(SCHEMES)


@pytest.mark.parametrize("own", [True, False], ids=["read", "reader_of"])
def test_all_bytes_can_be_read_before_a_loss_raises(line, own, until):
    with open_port(line.url) as port:
        read = (lambda: port.read(port.in_waiting or 1)) if own else reader_of(port)
        port.timeout = BOUND_S
        line.begin()
        found = port.read(len(line.data) - 1)
        until(lambda: port.in_waiting == 1)
        line.lose()
        assert found + read() == line.data
        with pytest.raises(OSError, match=r"hung up|disconnected"):
            until(read)


@pytest.mark.parametrize("size", [1, 1000])
def test_a_read_waits_at_most_for_the_timeout(line, size):
    with open_port(line.silent) as port:
        assert port.read(size) == b""
        assert reader_of(port)() == b""
        assert port.in_waiting == 0


def test_bytes_can_be_written(line):
    with open_port(line.silent) as port:
        assert writer_of(port)(b"a") == 1


def test_a_closed_port_can_be_closed_and_neither_read_nor_written(line):
    port = open_port(line.silent)
    port.close()
    port.close()
    for used in (lambda: port.read(1), lambda: port.in_waiting, lambda: port.write(b"a")):
        with pytest.raises(serial.PortNotOpenError):
            used()


@pytest.mark.parametrize("scheme", LINES)
def test_a_url_that_cannot_be_opened_is_one_line_that_names_it(scheme):
    with pytest.raises(PortError) as refused:
        open_port(f"{scheme}://x:y?z=1")
    assert str(refused.value).isprintable()


# The simulated port


@pytest.fixture
def opened():
    """Open a simulated port; all are closed in the end."""
    ports = []

    def opens(query, **settings):
        port = serial.serial_for_url(f"sim://?{query}", 115_200, **settings)
        ports.append(port)
        return port

    yield opens
    for port in ports:
        port.close()


@pytest.mark.parametrize("sizes", [[1], [7, 1, 23], [400]])
def test_however_it_is_read_the_bytes_are_those_of_the_simulation(opened, sizes):
    asked = SimulationParameters(seed=9, rate=1000, drop=0.1, flip=0.1, noise=0.3)
    port = opened("seed=9&rate=1000&drop=0.1&flip=0.1&noise=0.3")
    read = b"".join(port.read(size) for size in itertools.islice(itertools.cycle(sizes), 40))
    expected = b"".join(item.data for item in itertools.islice(Simulation(asked), 5000))
    assert expected.startswith(read)
    assert len(read) == sum(itertools.islice(itertools.cycle(sizes), 40))


def test_commands_written_to_it_are_obeyed_however_they_are_cut(opened, until):
    port = opened("host=off&rate=1000", timeout=0.01)
    framer, speeds = Framer("sim"), {}

    def runs():
        for row in fed(framer, Chunk("sim", time.monotonic_ns(), port.read(100))):
            assert row.framed
            speeds[row.values["motor"]] = row.values["rpm"]
        return abs(speeds.get(3, 0) - 800) <= 1

    command = encode(KIND_BY_NAME["speed"], {"motor": 3, "rpm": 800})
    assert port.write(command[:4]) == 4
    assert port.write(bytearray(command[4:])) == 6
    until(runs)
    assert (speeds[1], speeds[2], speeds[4]) == (0, 0, 0)
