"""Where this machine answers by TCP: an address as one types it, and whether it can be had."""

import os
import socket
from dataclasses import dataclass
from typing import Self

from otc_dist.terminal.errors import UserError

_LOOPBACK = "127.0.0.1"
_EVERYWHERE = {"0.0.0.0", "::"}
_LAST = 65535


@dataclass(frozen=True)
class Port:
    """An address to listen at: IPv4, or IPv6 without its brackets, or a name of this machine."""

    host: str
    number: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """`9400` on the loopback alone; `0.0.0.0:9400`, `[::]:9400` for who reaches this machine.

        Raises:
            UserError: it is none.
        """
        host, colon, number = text.rpartition(":")
        bare = host.removeprefix("[").removesuffix("]")
        if not (number.isascii() and number.isdecimal()) or not 0 < int(number) <= _LAST:
            raise UserError(f"{text!r} is no port: 1 to {_LAST}, or HOST:PORT, as 0.0.0.0:9400")
        if (colon and not bare) or (":" in bare and bare == host):
            raise UserError(f"{text!r} is no HOST:PORT, as 0.0.0.0:9400 or [::]:9400")
        return cls(bare or _LOOPBACK, int(number))

    def meets(self, other: "Port") -> bool:
        """Whether only one process of this machine can listen at both."""
        hosts = {self.host, other.host}
        return self.number == other.number and (len(hosts) == 1 or bool(hosts & _EVERYWHERE))

    def check_free(self) -> None:
        """Raises UserError if nobody can listen there now."""
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                self.host, self.number, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            with socket.socket(family, kind, protocol) as there:
                # As servers do: connections of the one before may still be closing.
                there.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                there.bind(address)
                there.listen(1)
        except OSError as error:
            raise self.refused(error) from None

    def refused(self, error: OSError) -> UserError:
        """That the system does not let us listen there, and why."""
        why = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror
        return UserError(f"cannot listen at {self}: {why}")

    def __str__(self) -> str:
        return f"[{self.host}]:{self.number}" if ":" in self.host else f"{self.host}:{self.number}"
