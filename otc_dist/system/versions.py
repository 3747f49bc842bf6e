"""Which versions of packages something was made with."""

from importlib.metadata import PackageNotFoundError, version

# What can change a run's bits, or how they are written down.
PACKAGES = ("mujoco", "numpy", "scipy", "mcap", "msgpack", "torch", "eclipse-zenoh")


def of_packages(*packages: str) -> dict[str, str]:
    """Package -> version of those that are installed, in the given order."""
    found = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
