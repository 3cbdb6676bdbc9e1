"""Hitchhiking for mobile robots: one robot rides behind another and saves its own navigation."""
