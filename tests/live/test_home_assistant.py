"""Home Assistant learns of cameras, lines and zones by MQTT discovery."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jinja2
import numpy as np
import pytest
from camera_server import Scripted

from phdtrack.errors import InputError
from phdtrack.live.engine import Camera, CameraParts, CameraSettings
from phdtrack.live.events import Count, Watch, WatchState
from phdtrack.live.home_assistant import HomeAssistant
from phdtrack.live.zones import Place
from phdtrack.types import SequenceInfo

DOOR = Place('the "Tür"', ((80.0, 119.0), (80.0, 0.0)), closed=False)
ROOM = Place("room", ((0.0, 0.0), (100.0, 0.0), (100.0, 119.0)), closed=True)
SUFFIX = "/config"


class Client:
    """Stands for that of paho. ``kept`` are the retained messages of a broker."""

    on_connect: Any = None

    def __init__(self) -> None:
        self.kept = dict[str, str | bytes]()
        self.published = list[str]()
        self.calls = list[tuple[Any, ...]]()
        self.connected = False

    def will_set(self, topic: str, content: str, qos: int, retain: bool) -> None:
        self.calls.append(("will", topic, content, qos, retain))

    def username_pw_set(self, user: str, password: str) -> None:
        self.calls.append(("log in", user, password))

    def connect_async(self, host: str, port: int) -> None:
        self.calls.append(("connect", host, port))

    def loop_start(self) -> None:
        self.calls.append(("loop",))

    def disconnect(self) -> None:
        self.calls.append(("disconnect",))

    def loop_stop(self) -> None:
        self.calls.append(("stop",))

    def is_connected(self) -> bool:
        return self.connected

    def publish(self, topic: str, content: str | bytes, qos: int, retain: bool) -> SimpleNamespace:
        assert (qos, retain) == (1, True)
        self.published.append(topic)
        self.kept[topic] = content
        if not content:
            # A broker forgets what is replaced by nothing.
            del self.kept[topic]
        return SimpleNamespace(wait_for_publish=lambda timeout: None)

    def come(self) -> None:
        """The connection is there."""
        self.connected = True
        self.on_connect(self, None, {}, 0, None)


def camera(folder: Path, places: tuple[Place, ...], snapshots: int = 0) -> Camera:
    """A camera that is not started: a test says what it has seen."""

    def make(info: SequenceInfo) -> CameraParts:
        raise AssertionError

    settings = CameraSettings(folder, watch=Watch(places), video=0, snapshots=snapshots)
    return Camera("front gate", Scripted(), make, settings)


def described(client: Client) -> dict[str, dict[str, Any]]:
    """The entities by their topic, without what all topics have."""
    return {
        topic.removeprefix("homeassistant/").removesuffix(SUFFIX): json.loads(content)
        for topic, content in client.kept.items()
        if topic.endswith(SUFFIX)
    }


def shown(client: Client) -> dict[str, str]:
    """The value of each sensor by its name, as Home Assistant renders it."""
    found = {}
    for one in described(client).values():
        if "state_topic" in one:
            state = json.loads(client.kept[one["state_topic"]])
            template = jinja2.Template(one["value_template"])
            found[one["name"]] = template.render(value_json=state)
    return found


def test_entities_are_announced_and_have_their_values(tmp_path: Path) -> None:
    client = Client()
    assistant = HomeAssistant("mqtt://bob:pass@broker.example/site", lambda: client)
    assert client.calls == [
        ("log in", "bob", "pass"),
        ("will", "site/status", "offline", 1, True),
        ("connect", "broker.example", 1883),
        ("loop",),
    ]
    one = camera(tmp_path, (DOOR, ROOM))
    assistant.update([one], 0.0)
    assert client.published == []
    client.come()
    one.tracks = 3
    one.watched = (one.watched[0], WatchState({}, (Count(5, 2), Count(4, 3, 9.0))))
    assistant.update([one], 1.0)
    assert shown(client) == {
        "working": "OFF",
        "tracks": "3",
        'the "Tür" in': "5",
        'the "Tür" out': "2",
        "room occupancy": "1",
        "room entered": "4",
        "room left": "3",
    }
    entities = described(client)
    assert len({each["unique_id"] for each in entities.values()}) == len(entities) == 7
    assert {each["availability_topic"] for each in entities.values()} == {"site/status"}
    assert {each["device"]["name"] for each in entities.values()} == {"front gate"}
    assert client.kept["site/status"] == "online"
    # Home Assistant takes these characters only.
    for topic in entities:
        assert len(topic.split("/")) == 3
        assert all(character.isascii() and character not in "+#" for character in topic)


def test_values_are_published_when_they_change_once_a_second(tmp_path: Path) -> None:
    client = Client()
    assistant = HomeAssistant("mqtt://broker.example/site", lambda: client)
    client.come()
    one = camera(tmp_path, (ROOM,))
    assistant.update([one], 1.0)
    sent = len(client.published)
    one.tracks = 1
    assistant.update([one], 1.2)
    assert len(client.published) == sent
    assistant.update([one], 2.2)
    assistant.update([one], 4.0)
    assert client.published[sent:] == [topic for topic in client.kept if topic.endswith("/state")]
    assert shown(client)["tracks"] == "1"


def test_gone_places_are_deleted_and_a_new_broker_is_told_all(tmp_path: Path) -> None:
    client = Client()
    assistant = HomeAssistant("mqtt://broker.example/site", lambda: client)
    client.come()
    one = camera(tmp_path, (DOOR, ROOM))
    assistant.update([one], 1.0)
    watch = Watch((DOOR,))
    one.watched = (watch, watch.start())
    assistant.update([one], 3.0)
    assert set(shown(client)) == {"working", "tracks", 'the "Tür" in', 'the "Tür" out'}
    before = dict(client.kept)
    client.kept.clear()
    client.come()
    assistant.update([one], 3.1)
    assert client.kept == before
    assistant.stop()
    assert client.kept["site/status"] == "offline"
    assert client.calls[-2:] == [("disconnect",), ("stop",)]


def test_the_newest_picture_is_an_image(tmp_path: Path) -> None:
    client = Client()
    assistant = HomeAssistant("mqtt://broker.example/site", lambda: client)
    client.come()
    one = camera(tmp_path, (DOOR,), snapshots=3)
    assistant.update([one], 1.0)
    (image,) = [each for topic, each in described(client).items() if topic.startswith("image/")]
    assert image["content_type"] == "image/jpeg"
    assert image["image_topic"] not in client.kept
    one.snapshots.newest = tmp_path / "1.jpg"
    content = bytes(np.arange(5, dtype=np.uint8))
    one.snapshots.newest.write_bytes(content)
    assistant.update([one], 1.1)
    assistant.update([one], 1.2)
    assert client.kept[image["image_topic"]] == content
    assert client.published.count(image["image_topic"]) == 1
    # One that is gone already stops nothing.
    one.snapshots.newest = tmp_path / "2.jpg"
    assistant.update([one], 1.3)
    assert client.kept[image["image_topic"]] == content


def test_a_broker_that_is_not_there_is_a_problem_until_it_comes(tmp_path: Path) -> None:
    client = Client()
    assistant = HomeAssistant("mqtt://broker.example/site", lambda: client)
    one = camera(tmp_path, (DOOR,))
    assistant.update([one], 5.0)
    assert assistant.problem == ""
    assistant.update([one], 16.0)
    assert assistant.problem == "the broker does not answer"
    reason = SimpleNamespace(is_failure=True)
    client.on_connect(client, None, {}, reason, None)
    assert assistant.problem.startswith("the broker refuses the connection: ")
    client.come()
    assistant.update([one], 17.0)
    assert assistant.problem == ""
    assert client.kept["site/status"] == "online"
    client.connected = False
    assistant.update([one], 18.0)
    assistant.update([one], 27.0)
    assert assistant.problem == ""
    assistant.update([one], 29.0)
    assert assistant.problem == "the broker does not answer"


def test_an_address_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="begins with mqtt://"):
        HomeAssistant("http://broker.example", Client)
