# What the batch scripts of this folder share; they source it.

# The environment pdpetsc was installed in, for instance: module load petsc4py; source env/bin/activate
# One thread a rank: ranks are the parallelism, a threaded BLAS under them only fights for the cores.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

# Compiled kernels are kept in a folder that all nodes see, from job to job.
export NUMBA_CACHE_DIR="${NUMBA_CACHE_DIR:-${HOME}/.cache/pdpetsc}"
mkdir -p "$NUMBA_CACHE_DIR"

# On many nodes every rank would read them, and all of Python, from the shared file system at the same moment. Kernels go
# to the local disk of each node first, one process a node; and if PDPETSC_PACKED names a .tar of the environment
# (tar -cf env.tar -C env .), that is unpacked beside them and used.
if [ "${SLURM_JOB_NUM_NODES:-1}" -gt 1 ]; then
    local_folder="${TMPDIR:-/tmp}/pdpetsc-${SLURM_JOB_ID}"
    each_node() { srun --ntasks="$SLURM_JOB_NUM_NODES" --ntasks-per-node=1 "$@"; }
    each_node mkdir -p "$local_folder/kernels"
    each_node cp -r "$NUMBA_CACHE_DIR/." "$local_folder/kernels"
    export NUMBA_CACHE_DIR="$local_folder/kernels"
    if [ -n "${PDPETSC_PACKED:-}" ]; then
        each_node mkdir -p "$local_folder/env"
        each_node tar -xf "$PDPETSC_PACKED" -C "$local_folder/env"
        export PATH="$local_folder/env/bin:$PATH"
    fi
fi
