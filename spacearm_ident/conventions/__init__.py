"""What is wrong with a recording's conventions, tested on the data: units, signs, order, zeros, gravity, clock."""
