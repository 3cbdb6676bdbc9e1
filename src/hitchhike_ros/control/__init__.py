"""Path following, obstacle avoidance and the arbitration of velocity commands."""
