"""The workbench: sessions, runs and drives in the browser. It stands on all other rooms and keeps nothing of its
own: it reads the files that the commands write, and changes them by the functions that the commands call."""

from behavioural_cloning_toolkit import refuse_hidden

refuse_hidden(__name__)
