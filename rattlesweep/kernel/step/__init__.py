"""Steps: methods, explicit steps of rolling bodies, implicit ones of slides."""
