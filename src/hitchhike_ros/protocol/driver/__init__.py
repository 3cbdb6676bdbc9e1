"""The driver: its states, and the riders whom it carries."""
