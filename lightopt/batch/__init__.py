"""Many commands on many rigs and parts, or the tasks of one command, by processes of this machine or of a cluster.

A batch file names jobs, rigs and parts. Each job × rig × part is a :class:`Task`, which runs a command of the command
line. Its results are in a folder of their own, together with the hash of all that they depend on, and are never
computed twice. :func:`other_processes` lets one command spread its own work. Home of Dask.
"""

from ._cluster import Workers
from ._expand import CommandForm, OptionForm
from ._pool import other_processes
from ._run import BatchResult, answer_text, jobs_table, run_batch
