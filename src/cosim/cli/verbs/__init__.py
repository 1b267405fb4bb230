"""The verbs, a file each: `add_options(parser)` says what it takes, `run(args)` does it."""
