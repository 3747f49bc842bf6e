"""BREMEN, in parts: algorithm.py puts them together."""
