"""The subcommands, by theme; each imports what it needs when it runs, so that `--help` is quick."""
