"""Games made up from a scenario and a seed, as logs with exact truth."""
