"""Deployment logs: one MCAP file per deployment, the only durable record of what happened.

`writer.LogWriter` writes ahead and finishes, `reader` reads finished and unfinished files.
"""
