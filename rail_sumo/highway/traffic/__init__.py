"""The vehicles of the demand, or made where there is none: which are driven, and how they come and go."""
