"""Motion model, EKF, landmarks and the handover of a pose."""
