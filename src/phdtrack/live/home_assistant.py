"""Cameras, lines and zones as devices of Home Assistant, by its MQTT discovery.

Each camera is a device. The description of each of its entities is a retained message below
`DISCOVERY`, so that Home Assistant knows them after its own restart too. Their values are one
retained message per camera, ``TOPIC/CAMERA/state``: JSON with the number of tracks and the counts
of each place. ``TOPIC/status`` is ``online``, and the broker makes it ``offline`` if the connection
is lost.
"""

from __future__ import annotations

import json
import math
import re
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from phdtrack.live.delivery import TIMEOUT, Broker, paho_client
from phdtrack.live.engine import Camera
from phdtrack.live.zones import Place

# Where Home Assistant looks unless it is told otherwise.
DISCOVERY = "homeassistant"
# Seconds between two messages with values of a camera.
_EVERY = 1.0


class _Entity(NamedTuple):
    """A sensor: its component, its key in messages, its name, and what it has of its own."""

    component: str
    key: str
    name: str
    more: Mapping[str, object]


class HomeAssistant:
    """Announces cameras to Home Assistant, and publishes their values when they change.

    Parameters
    ----------
    url : the broker, as ``mqtt://[user:password@]host[:port]/topic``.
    make_client : makes a client with the methods of paho-mqtt's.

    Raises
    ------
    InputError : the address is invalid, or paho-mqtt is missing.
    """

    def __init__(self, url: str, make_client: Callable[[], Any] = paho_client) -> None:
        broker = Broker.of(url)
        self._topic = broker.topic
        self._status = f"{broker.topic}/status"
        self._client = make_client()
        self._client.on_connect = self._connected
        broker.log_in(self._client)
        self._client.will_set(self._status, "offline", qos=1, retain=True)
        # Topics of descriptions of each camera, its values and when they were published, and its
        # newest picture.
        self._described = dict[str, dict[str, str]]()
        self._values = dict[str, tuple[str, float]]()
        self._shown = dict[str, Path]()
        self._anew = False
        # Why the broker refuses the connection, and the time from which on it should be there.
        self._refused = ""
        self._expected = math.nan
        self._late = False
        # In a thread of its own, which also repeats failed attempts.
        self._client.connect_async(broker.host, broker.port)
        self._client.loop_start()

    def update(self, cameras: Sequence[Camera], now: float) -> None:
        """Publish what has changed; call it a few times a second.

        Parameters
        ----------
        cameras : all that there are.
        now : seconds that only grow.
        """
        if not self._client.is_connected():
            if math.isnan(self._expected):
                self._expected = now + TIMEOUT
            self._late = now > self._expected
            return
        self._expected = math.nan
        self._late = False
        if self._anew:
            # The broker may have been another one, or have forgotten everything.
            self._anew = False
            self._described.clear()
            self._values.clear()
            self._shown.clear()
            self._publish(self._status, "online")
        for one in cameras:
            self._describe(one)
            self._tell(one, now)

    @property
    def problem(self) -> str:
        """Why nothing can be published, after some seconds; empty if it can be."""
        if self._late and self._refused:
            return f"the broker refuses the connection: {self._refused}"
        if self._late:
            return "the broker does not answer"
        return ""

    def stop(self) -> None:
        """Say that nothing is published any more, and end the connection."""
        if self._client.is_connected():
            told = self._client.publish(self._status, "offline", qos=1, retain=True)
            told.wait_for_publish(1.0)
        self._client.disconnect()
        self._client.loop_stop()

    def _connected(self, client: Any, data: Any, flags: Any, reason: Any, *more: Any) -> None:
        """Take note of a new connection, or of why there is none."""
        self._refused = str(reason) if getattr(reason, "is_failure", False) else ""
        self._anew = not self._refused

    def _publish(self, topic: str, content: str | bytes) -> None:
        """Publish a message that the broker keeps."""
        self._client.publish(topic, content, qos=1, retain=True)

    def _describe(self, camera: Camera) -> None:
        """Publish the descriptions of a camera's entities that are new or have changed, and delete
        those of places that are gone.
        """
        node = f"{_slug(self._topic)}_{_slug(camera.name)}"
        device = {
            "identifiers": [node],
            "name": camera.name,
            "manufacturer": "phdtrack",
            "model": "camera",
        }
        described = dict[str, str]()
        for one in _entities(camera):
            whole = {
                "name": one.name,
                "unique_id": f"{node}_{one.key}",
                "availability_topic": self._status,
                "device": device,
            }
            where = "image_topic" if one.component == "image" else "state_topic"
            what = "snapshot" if one.component == "image" else "state"
            whole[where] = f"{self._topic}/{_slug(camera.name)}/{what}"
            described[f"{DISCOVERY}/{one.component}/{node}/{one.key}/config"] = json.dumps(
                {**whole, **one.more}
            )
        before = self._described.get(camera.name, {})
        for topic, text in described.items():
            if before.get(topic) != text:
                self._publish(topic, text)
        for topic in before.keys() - described.keys():
            self._publish(topic, "")
        self._described[camera.name] = described

    def _tell(self, camera: Camera, now: float) -> None:
        """Publish the values of a camera, and its newest picture, if they are new."""
        topic = f"{self._topic}/{_slug(camera.name)}"
        text = json.dumps(_values(camera))
        before, last = self._values.get(camera.name, ("", now - _EVERY))
        if text != before and now - last >= _EVERY:
            self._publish(f"{topic}/state", text)
            self._values[camera.name] = text, now
        newest = camera.snapshots.newest
        if newest is not None and newest != self._shown.get(camera.name):
            self._shown[camera.name] = newest
            try:
                self._publish(f"{topic}/snapshot", newest.read_bytes())
            except FileNotFoundError:
                # So many events since that it is gone already: a newer one comes.
                return


def _entities(camera: Camera) -> Iterator[_Entity]:
    """The entities of a camera: two of its own, its newest picture, and those of each place."""
    working = {
        "device_class": "connectivity",
        "value_template": "{{ 'ON' if value_json.working else 'OFF' }}",
    }
    yield _Entity("binary_sensor", "working", "working", working)
    present = {"state_class": "measurement", "value_template": "{{ value_json.tracks }}"}
    yield _Entity("sensor", "tracks", "tracks", present)
    if camera.settings.snapshots:
        yield _Entity("image", "snapshot", "last event", {"content_type": "image/jpeg"})
    for place in camera.watched[0].places:
        for key in _counts(place):
            kind = "measurement" if key == "occupancy" else "total_increasing"
            template = f"{{{{ value_json.places[{json.dumps(place.name)}]['{key}'] }}}}"
            more = {"state_class": kind, "value_template": template}
            yield _Entity("sensor", f"{_slug(place.name)}_{key}", f"{place.name} {key}", more)


def _counts(place: Place) -> tuple[str, ...]:
    """The names of the counts of a place."""
    if place.closed:
        return ("occupancy", "entered", "left")
    return ("in", "out")


def _values(camera: Camera) -> dict[str, object]:
    """The values of a camera's entities."""
    watch, state = camera.watched
    places = dict[str, dict[str, int]]()
    for place, count in zip(watch.places, state.counts, strict=True):
        numbers = [count.entered, count.left]
        if place.closed:
            numbers.insert(0, count.occupancy)
        places[place.name] = dict(zip(_counts(place), numbers, strict=True))
    working = camera.working and camera.source.status().state == "live"
    return {"working": working, "tracks": camera.tracks, "places": places}


def _slug(name: str) -> str:
    """The name in characters that topics may have; different names stay different."""
    plain = re.sub(r"[^A-Za-z0-9_-]", "_", name)
    if plain == name:
        return name
    return f"{plain}_{zlib.crc32(name.encode()):08x}"
