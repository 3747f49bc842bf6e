"""Why a link does not come about: Zenoh only says that it does not."""

import socket
import ssl

from otc_dist.bus.addresses import is_ipv6
from otc_dist.bus.endpoints import TLS, Endpoint
from otc_dist.bus.identity import Identity

_PATIENCE = 1.0  # seconds for each step
_TLS_ALERT = b"\x15"
# Alerts of a server that does not want our certificate, in OpenSSL's words.
_ALERTS = {
    "CERTIFICATE_REQUIRED": "demands a certificate, and got none",
    "HANDSHAKE_FAILURE": "demands a certificate, and got none",
    "UNKNOWN_CA": "trusts another authority than the one that issued our certificate",
    "DECRYPT_ERROR": "trusts another authority than the one that issued our certificate",
    "CERTIFICATE_EXPIRED": "says that our certificate has expired",
    "CERTIFICATE_UNKNOWN": "does not accept our certificate",
    "BAD_CERTIFICATE": "does not accept our certificate",
    "UNSUPPORTED_CERTIFICATE": "does not accept our certificate as that of a learner",
}


def refusal(endpoint: Endpoint) -> str | None:
    """One line on why `endpoint` accepts no link; None if nobody listens, or nothing is wrong.

    It opens a connection of its own, and looks at how that ends.
    """
    address = _address(endpoint)
    if address is None:
        return None
    if not endpoint.locator.startswith(TLS):
        check = _of_plain
    elif is_ipv6(address[0]):  # its TLS takes the brackets for a part of the name (Zenoh 1.10)
        return (
            f"{endpoint.locator}: Zenoh does not link to IPv6 addresses by TLS; connect to a name"
        )
    else:
        check = _of_tls
    try:
        return check(endpoint, address)
    except OSError:  # nobody there, or nobody who answers
        return None


def absence(endpoint: Endpoint) -> str | None:
    """One line on what is missing at `endpoint`; None if somebody answers, or if unknown."""
    address = _address(endpoint)
    if address is None:
        return None
    try:
        socket.create_connection(address, _PATIENCE).close()
    except socket.gaierror:
        reason = f"this machine does not know {address[0]}; check the name"
    except OSError:
        reason = (
            "nobody answers there yet; start the env host (or the router), or check the address"
        )
    else:
        return None
    return f"waiting for {endpoint.locator}: {reason}"


def _address(endpoint: Endpoint) -> tuple[str, int] | None:
    protocol, _, place = endpoint.locator.partition("/")
    host, _, port = place.rpartition(":")
    if protocol not in ("tls", "tcp") or not port.isdecimal():
        return None
    return host.strip("[]"), int(port)


def _of_tls(endpoint: Endpoint, address: tuple[str, int]) -> str | None:
    where = endpoint.locator
    try:
        with (
            socket.create_connection(address, _PATIENCE) as connection,
            _context(endpoint.identity).wrap_socket(connection, server_hostname=address[0]) as tls,
        ):
            tls.recv(1)  # a server looks at our certificate after we have looked at its
            return None
    except (TimeoutError, ConnectionError, ssl.SSLEOFError):
        # Without TLS, or it is frozen, or has just died.
        return _not_tls(where) if _answers_without_tls(address) else None
    except ssl.SSLCertVerificationError as error:
        # OpenSSL's words: "certificate has expired", "self-signed certificate in certificate chain"
        return (
            f"the certificate of {where} is refused: {error.verify_message.strip().rstrip('.')};"
            " do both sides hold certificates of the same python -m otc_dist.certs?"
        )
    except ssl.SSLError as error:
        for alert, meaning in _ALERTS.items():
            if alert in (error.reason or ""):
                return f"{where} {meaning}: is --certs the right folder?"
        if "WRONG_VERSION" in (error.reason or ""):
            return _not_tls(where)
        return f"{where} refuses TLS: {error.reason}"


def _not_tls(where: str) -> str:
    return f"{where} does not speak TLS: does it run with --insecure?"


def _answers_without_tls(address: tuple[str, int]) -> bool:
    """Whether Zenoh without TLS listens: for the rest of a TLS greeting it would wait for ever."""
    with socket.create_connection(address, _PATIENCE) as connection:
        connection.sendall(b"\x01\x00\x00")  # a message of one byte, which is none
        return connection.recv(1) not in (b"", _TLS_ALERT)


def _of_plain(endpoint: Endpoint, address: tuple[str, int]) -> str | None:
    """Whether a server that was asked without TLS speaks TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with socket.create_connection(address, _PATIENCE) as connection:
            context.wrap_socket(connection).close()
    except ssl.SSLError as error:
        if "ALERT" not in (error.reason or ""):
            return None
    place = endpoint.locator.partition("/")[2]
    return f"{endpoint.locator} speaks TLS: use tls/{place} with --certs DIR"


def _context(identity: Identity | None) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=identity.authority if identity else None)
    if identity is not None:
        context.load_cert_chain(identity.certificate, identity.key)
    return context
