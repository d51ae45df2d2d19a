"""Handover: hold a remote control where the person's right hand can take it."""
