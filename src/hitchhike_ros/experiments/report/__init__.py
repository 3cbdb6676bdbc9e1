"""What a person looks at after a run: tables, pictures and the page."""
