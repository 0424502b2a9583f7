"""Training of the sky model and of the confidence.

`python -m skyline_training` lists the commands. Drawn photographs (`landscapes`, `plain_photos`,
`photos`) train the network of the sky model (`network`); matched queries (`examples`) train the
confidence (`confidence`).
"""
