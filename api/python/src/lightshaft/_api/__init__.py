"""Every call of the API, as coroutines over an `Io`: one file for each kind of thing."""
