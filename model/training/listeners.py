"""The listeners to a training's progress. A listener that fails does not end the training: it is dropped, with a
notice at once and at the end of the training."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Final

from common import UserError
from common.named_function import in_one_line
from model.runs.training_progress import Epoch, Listener, Step

_LOGGER: Final = logging.getLogger(__name__)


class Listeners:
    def __init__(self, listeners: Sequence[Listener], notices: list[str]) -> None:
        """For each listener that fails, a line is added to `notices`."""
        self._listening = list(listeners)
        self._notices = notices

    def step(self, step: Step) -> None:
        self._call_each(lambda listener: listener.step(step))

    def epoch(self, epoch: Epoch) -> None:
        self._call_each(lambda listener: listener.epoch(epoch))

    def close(self) -> None:
        """Close all remaining listeners. Failed ones are already closed."""
        self._call_each(_close)

    def _call_each(self, method: Callable[[Listener], object]) -> None:
        for listener in list(self._listening):
            if error := _error_of(method, listener):
                self._listening.remove(listener)
                _error_of(_close, listener)  # it may still save data; a second error is ignored
                why = str(error) if isinstance(error, UserError) else in_one_line(error)
                line = f"{type(listener).__name__} receives nothing more of this training: {why}"
                self._notices.append(line)
                _LOGGER.warning("%s", line)


def _close(listener: Listener) -> object:
    return listener.close()


def _error_of(method: Callable[[Listener], object], listener: Listener) -> Exception | None:
    try:
        method(listener)
    except Exception as error:  # a user's own code
        return error
    return None
