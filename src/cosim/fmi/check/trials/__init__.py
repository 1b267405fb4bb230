"""What an FMU must do when it runs: one small function per rule, each on instances of its own."""
