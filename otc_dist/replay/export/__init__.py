"""`--export`: deployment logs as data sets that other tools read, one module a format."""
