"""The grid simulator: many robots on a map, from event to event, without physics."""
