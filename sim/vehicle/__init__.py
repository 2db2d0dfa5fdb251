"""The MAVLink interface of the simulated vehicle: streams, parameters, routing, autopilot
flavours."""
