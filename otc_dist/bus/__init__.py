"""The bus: keys, messages, sessions, lock-step. The only code that knows Zenoh."""
