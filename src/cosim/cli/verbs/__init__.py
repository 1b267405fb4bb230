"""The verbs, a file each: `add_parser(verbs)` says what it takes, `run(args)` does it."""
