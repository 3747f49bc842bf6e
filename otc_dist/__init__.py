"""Online tuning for offline decentralized multi-agent RL, as a distributed system."""

__version__ = "0.1.0"
