"""What can be done with a deployment log: `python -m otc_dist.replay`, one module an action."""
