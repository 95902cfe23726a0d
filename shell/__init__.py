"""The shell of the command line: verbs, output, files, and what every service needs."""
