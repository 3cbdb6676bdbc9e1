"""What is driven, and the record that it leaves."""
