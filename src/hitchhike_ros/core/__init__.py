"""What every other room uses: data types, geometry, errors, parameters and the model of a robot."""
