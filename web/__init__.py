"""The workbench: sessions, runs and drives in the browser. It uses all other rooms. It reads the files that the
commands write, and changes them with the functions of the commands."""
