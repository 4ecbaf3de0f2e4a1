"""Training of mipbake's networks: `python -m mipbake.training train CONFIG`.

To read it from top to bottom: config, data (with augmentation and generated materials), loss, loop, validation.
"""
