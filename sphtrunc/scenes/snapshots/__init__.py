"""Snapshots: the particles that codes write.

One file for each format turns bytes into a `Table` of columns under the names of the code;
`columns` translates these names, `snapshot` decides what the columns mean (dimension, box, which
particles are targets) and checks every number, `formats` is the table of formats. Files are
hostile: nothing in one is executed or followed to another file, no size is believed before it is
compared with the size of the file, and whatever is wrong is a ValueError that names the file.
"""
