"""The MAVLink face of the simulated vehicle: streams, parameters, routing, autopilot flavours."""
