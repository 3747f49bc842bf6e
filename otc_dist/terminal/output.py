"""Output never ends work: what cannot be shown, or to nobody any more, is shown in part or not."""

import contextlib
import os
import sys
from pathlib import Path
from typing import Any, TextIO, cast


class _LossyStream:
    """A text stream that loses what cannot be written, instead of raising.

    As when the terminal has vanished, the reader of a pipe has gone, or the disk that holds the
    output is full. All else is the stream's own.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError, ValueError):  # ValueError: it is closed
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()

    def isatty(self) -> bool:
        try:
            return self._stream.isatty()
        except (OSError, ValueError):
            return False

    def __getattr__(self, name: str) -> Any:  # whatever else a text stream has
        return getattr(self._stream, name)


def steady() -> None:
    """Make the standard streams such that nothing written to them ends this process.

    Characters that they cannot show are replaced; a stream that was closed from the start takes
    what is written to it and drops it.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:  # closed; the next file that is opened would be taken for it
            with contextlib.suppress(OSError):
                os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            stream = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115  # to the end
        elif isinstance(stream, _LossyStream):
            continue
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace" if name == "stdout" else "backslashreplace")
        setattr(sys, name, cast(TextIO, _LossyStream(stream)))
