"""Checks of whether a stream of detections fits what the tracker assumes, with the cure if not."""

from phdtrack.input_checks.stream_checks import StreamChecks, StreamSeen, checks_of, longest_delay

__all__ = ["StreamChecks", "StreamSeen", "checks_of", "longest_delay"]
