"""Delivery of events to webhooks and by MQTT. Events that could not be sent are sent later, in
order, also after a restart.

A receiver may get an event twice if its answer is lost; ``id`` is the same then (also in the header
Idempotency-Key).
"""

from __future__ import annotations

import base64
import hashlib
import http.client
import ipaddress
import json
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, NamedTuple
from urllib.parse import SplitResult, unquote, urlsplit

from phdtrack.errors import InputError, needed
from phdtrack.live.outputs import EventLog

# Seconds without an answer, and of a whole delivery after the name is looked up.
TIMEOUT = 10.0
WHOLE = 30.0
FIRST_PAUSE = 1.0
LONGEST_PAUSE = 300.0
# IPv6 addresses that a gateway translates to IPv4; all other addresses of single machines.
_NAT64 = ipaddress.IPv6Network("64:ff9b::/96")
_UNICAST = ipaddress.IPv6Network("2000::/3")
Send = Callable[[str, str], None]
"""A function that sends an event, given its identifier and JSON. Raises `OSError` if it did not
arrive.
"""


@dataclass(frozen=True, slots=True)
class Webhook:
    """A webhook: each event is posted as JSON, with the user and password in the address (Basic).

    The name is looked up each time, and the connection goes to an address that was found: a name
    that leads to this machine or to a private network is refused, unless ``private`` networks are
    allowed. Redirections are not followed. A delivery takes at most half a minute after the
    look-up.
    """

    url: str
    private: bool = False

    def __post_init__(self) -> None:
        parts = _parts(self.url, "--webhook")
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise InputError(
                "expected an address that begins with http:// or https://", where="--webhook"
            )

    def __call__(self, name: str, event: str) -> None:
        """Post one event. Raises `OSError` unless an answer confirms it."""
        parts = urlsplit(self.url)
        host = str(parts.hostname)
        port = parts.port or (443 if parts.scheme == "https" else 80)
        connection = http.client.HTTPConnection(host, port, timeout=TIMEOUT)
        try:
            connection.sock, end = self._connected(host, port)
            if parts.scheme == "https":
                context = ssl.create_default_context()
                # The handshake follows below, where time is limited.
                connection.sock = context.wrap_socket(
                    connection.sock, False, False, server_hostname=host
                )
            headers = {"Content-Type": "application/json", "Idempotency-Key": name}
            if parts.username:
                user = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
                headers["Authorization"] = "Basic " + base64.b64encode(user.encode()).decode()
            path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
            with _until(end, connection.sock):
                if isinstance(connection.sock, ssl.SSLSocket):
                    connection.sock.do_handshake()
                connection.request("POST", path, event.encode(), headers)
                status = connection.getresponse().status
        except http.client.HTTPException as error:
            raise OSError(f"the answer is no HTTP ({type(error).__name__})") from error
        finally:
            connection.close()
        if not 200 <= status < 300:
            raise OSError(f"the answer was {status}")

    def _connected(self, host: str, port: int) -> tuple[socket.socket, float]:
        """A connection to an address of this name, and the time at which it must end. Raises
        `OSError` if the address is not allowed, or none answers.
        """
        try:
            found = [
                str(info[4][0]) for info in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
            ]
        except UnicodeError as error:
            raise OSError(f"{host} is not a valid name") from error
        if not self.private and not all(map(_public, found)):
            raise PermissionError(f"{host} is in a private network: allow it with --allow-private")
        end = time.monotonic() + WHOLE
        for one in found[:-1]:
            with suppress(OSError):
                return socket.create_connection((one, port), _left(end)), end
        return socket.create_connection((found[-1], port), _left(end)), end


def _left(end: float) -> float:
    """Seconds to wait for an answer. Raises `TimeoutError` after ``end``."""
    if time.monotonic() >= end:
        raise TimeoutError(f"it took more than {WHOLE:g} s")
    return min(TIMEOUT, end - time.monotonic())


@contextmanager
def _until(end: float, sock: socket.socket) -> Iterator[None]:
    """Cut the connection at ``end`` and raise `TimeoutError`; the socket's own time-out begins anew
    with each byte.
    """

    def cut() -> None:
        with suppress(OSError):
            # Not the TLS socket's shutdown: another thread uses that socket.
            socket.socket.shutdown(sock, socket.SHUT_RDWR)

    timer = threading.Timer(end - time.monotonic(), cut)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        # An answer that was cut may look complete.
        _left(end)


def _public(text: str) -> bool:
    """True if an address is on the internet; IPv6 forms of IPv4 addresses count as IPv4."""
    address = ipaddress.ip_address(text)
    if isinstance(address, ipaddress.IPv6Address):
        inner = address.ipv4_mapped or address.sixtofour
        if address in _NAT64:
            inner = ipaddress.IPv4Address(int(address) & 0xFFFFFFFF)
        if inner is None and address not in _UNICAST:
            return False
        address = inner or address
    return address.is_global and not (address.is_multicast or address.is_reserved)


def _parts(url: str, where: str) -> SplitResult:
    """The parts of an address. Raises `InputError` if it is invalid."""
    with suppress(ValueError):
        parts = urlsplit(url)
        if parts.port != 0 and url.isascii() and url.isprintable() and " " not in url:
            return parts
    raise InputError(
        "expected an address in printable ASCII, others as %XX, with a port up to 65535",
        where=where,
    )


def paho_client() -> Any:
    """A client of paho-mqtt. Raises `InputError` if that is missing."""
    version = needed("paho.mqtt.enums").CallbackAPIVersion.VERSION2
    return needed("paho.mqtt.client").Client(version)


class Broker(NamedTuple):
    """The parts of a broker's address, as ``mqtt://[user:password@]host[:port]/topic``.

    Attributes
    ----------
    host, port, topic : where it listens, and where events go.
    user, password : empty without.
    encrypted : whether the connection is by TLS.
    """

    host: str
    port: int
    topic: str
    user: str
    password: str
    encrypted: bool

    @classmethod
    def of(cls, url: str) -> Broker:
        """The parts of an address. Raises `InputError` if it is invalid."""
        parts = _parts(url, "--mqtt")
        if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname:
            raise InputError(
                "expected an address that begins with mqtt:// or mqtts://", where="--mqtt"
            )
        topic = parts.path.strip("/") or "phdtrack"
        if set(topic) & set("+#"):
            raise InputError("expected a topic without the wildcards + and #", where="--mqtt")
        encrypted = parts.scheme == "mqtts"
        port = parts.port or (8883 if encrypted else 1883)
        user = unquote(parts.username or "")
        return cls(parts.hostname, port, topic, user, unquote(parts.password or ""), encrypted)

    def log_in(self, client: Any) -> None:
        """Give user, password and encryption to a client with the methods of paho-mqtt's."""
        if self.user:
            client.username_pw_set(self.user, self.password)
        if self.encrypted:
            client.tls_set()


class Mqtt:
    """Publishes each event to ``topic``/kind of a broker
    (``mqtt://[user:password@]host[:port]/topic``), at least once.

    Parameters
    ----------
    url : the address.
    make_client : makes a client with the methods of paho-mqtt's.

    Raises
    ------
    InputError : the address is invalid, or paho-mqtt is missing.
    """

    def __init__(self, url: str, make_client: Callable[[], Any] = paho_client) -> None:
        self._broker = Broker.of(url)
        # The last event that the client got, and its number there; the numbers that the broker has
        # confirmed.
        self._published = ("", 0)
        self._confirmed = set[int]()
        self._news = threading.Condition()
        self._client = make_client()
        self._client.on_publish = self._confirm
        self._broker.log_in(self._client)

    def __call__(self, name: str, event: str) -> None:
        """Publish one event. Raises `OSError` if the broker does not confirm it in ten seconds."""
        if not self._client.is_connected():
            self._client.connect(self._broker.host, self._broker.port)
            self._client.loop_start()
        if self._published[0] != name:
            # The client itself repeats unconfirmed events, also over a new connection: an event
            # that is published twice arrives twice.
            topic = f"{self._broker.topic}/{json.loads(event)['kind']}"
            self._published = name, int(self._client.publish(topic, event, qos=1).mid)
        with self._news:
            if not self._news.wait_for(lambda: self._published[1] in self._confirmed, TIMEOUT):
                raise OSError("the broker did not confirm")
            self._confirmed.clear()

    def _confirm(self, client: Any, data: Any, number: int, *more: Any) -> None:
        """Take note that the broker has confirmed an event."""
        with self._news:
            self._confirmed.add(number)
            self._news.notify_all()


def receivers(addresses: Iterable[str]) -> list[str]:
    """A name for each address, which stays the same after a restart.

    It is a hash of host, port and path; user, password and query may change, and are written
    nowhere. Equal names are numbered. Raises `InputError` for an invalid address.
    """
    found = list[str]()
    for address in addresses:
        parts = _parts(address, "--webhook, --mqtt")
        port = parts.port or {"http": 80, "https": 443, "mqtt": 1883, "mqtts": 8883}.get(
            parts.scheme
        )
        plain = f"{parts.scheme.removesuffix('s')}://{parts.hostname}:{port}{parts.path}"
        name = hashlib.sha256(plain.encode()).hexdigest()[:16]
        count = 1
        while f"{name}-{count}" in found:
            count += 1
        found.append(f"{name}-{count}")
    return found


class Courier:
    """Delivers the events that wait in a log, in a thread of its own. After each failure it waits
    twice as long, at most five minutes.

    ``receiver`` is its name in the log, from `receivers`.
    """

    def __init__(self, log: EventLog, send: Send, receiver: str) -> None:
        self._log = log
        self._send = send
        self._receiver = receiver
        self.problem = ""
        log.register(receiver)
        # The row of the last event that was sent: to record it may fail.
        self._sent = 0
        self._wake = threading.Event()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="phdtrack events", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Signal new events."""
        self._wake.set()

    def stop(self, patience: float = 1.0) -> None:
        """Stop delivering; waiting events are kept."""
        self._stopped.set()
        self._wake.set()
        self._thread.join(patience)

    def _run(self) -> None:
        pause = FIRST_PAUSE
        while not self._stopped.is_set():
            self._wake.clear()
            try:
                waiting = self._log.waiting(self._receiver)
                for row, name, event in waiting:
                    if row != self._sent:
                        self._send(name, event)
                        self._sent = row
                    self._log.delivered(self._receiver, row)
                    pause = FIRST_PAUSE
                    self.problem = ""
                    if self._stopped.is_set():
                        return
            except Exception as error:
                self.problem = (
                    str(getattr(error, "strerror", None) or error) or type(error).__name__
                )
                # New events do not shorten the pause.
                self._stopped.wait(pause)
                pause = min(2 * pause, LONGEST_PAUSE)
                continue
            if not waiting:
                self._wake.wait()
