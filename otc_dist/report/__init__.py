"""Reports: what came of a run, as `results.json` and as a page that needs nothing else."""
