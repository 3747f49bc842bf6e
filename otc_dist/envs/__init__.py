"""Environments: batched multi-agent environments that the env host steps in lock-step."""
