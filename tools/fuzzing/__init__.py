"""What ``tools/fuzz.py`` is made of: base files, mutations of them, trials, worker processes."""
