"""The hitchhiker: its states, from asking to driving on alone."""
