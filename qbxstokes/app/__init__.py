"""The application: plans, runs, command line and what it prints."""
