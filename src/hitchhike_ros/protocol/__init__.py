"""Messages and the state machines of driver and hitchhiker."""
