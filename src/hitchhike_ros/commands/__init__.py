"""What a person types: commands that start, measure, draw and save."""
