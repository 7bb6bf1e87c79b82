#!/bin/bash
#SBATCH --job-name=@NAME@
#SBATCH --array=0-@LAST@
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=@CPUS@
#SBATCH --time=@TIME@
#SBATCH --signal=B:USR1@@WARNING@
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=@NAME@-%A_%a.log
@MORE@
# @ABOUT@ A task stops before its time limit and puts itself into the
# queue again, where it resumes; so does one whose node fails. @ENDING@
#   @FINISH@

set -uo pipefail

fail() {
    echo "error: $1" >&2
    exit "${2:-1}"
}

index=${SLURM_ARRAY_TASK_ID:-}
[[ $index =~ ^[0-9]+$ ]] || fail "this is a job array; hand it to sbatch" 2
cpus=${SLURM_CPUS_PER_TASK:-1}
restarts=${SLURM_RESTART_COUNT:-0}
task=${SLURM_ARRAY_JOB_ID:-?}_$index
program=(@PROGRAM@)
config=@CONFIG@
output=@OUTPUT@

# Check the environment before anything begins.
cd @WHERE@ 2>/dev/null || fail "$HOSTNAME does not see "@WHERE@
[[ -x ${program[0]} ]] || fail "$HOSTNAME does not see ${program[0]}, the program that wrote this script"
found=$("${program[@]}" --version 2>&1) ||
    fail "rattlesweep does not start on $HOSTNAME: ${found##*$'
'}"
[[ $found == *" @VERSION@" ]] ||
    fail "this script is of rattlesweep @VERSION@, and ${program[*]} is ${found##* }; regenerate it" 2
[[ -r $config ]] || fail "$HOSTNAME does not see $config" 2
mkdir -p "$output" 2>/dev/null && [[ -w $output ]] || fail "$HOSTNAME cannot write in $output"

# Keep compiled kernels in the folder that is named already, or else on the node's own disk, where
# only this user can put them.
cache=${NUMBA_CACHE_DIR:-}
[[ -n $cache ]] || cache=${SLURM_TMPDIR:-${TMPDIR:-/tmp}}/rattlesweep-$(id -u)
(umask 077 && mkdir -p "$cache" 2>/dev/null)
[[ -d $cache && -O $cache && ! -L $cache ]] || cache=$(mktemp -d) ||
    fail "$HOSTNAME has no room for compiled kernels"
export NUMBA_CACHE_DIR=$cache
export NUMBA_NUM_THREADS=$cpus

# Slurm sends USR1 when the time is nearly up, and TERM when the task is cancelled or its node is
# claimed by others; in that case Slurm decides whether the task comes back.
warned=0
heard=0
child=
# shellcheck disable=SC2317,SC2329
forward() {
    heard=1
    [[ $1 == USR1 ]] && warned=1
    [[ -n $child ]] && kill -TERM "$child" 2>/dev/null
}
trap 'forward USR1' USR1
trap 'forward TERM' TERM

echo "$(date '+%F %T') task $task on $HOSTNAME, $cpus threads, restart $restarts"
"${program[@]}" run "$config" --output "$output"@SETS@ \
    --shard "$index/@SHARDS@" --threads "$cpus" --max-time @SECONDS@s >/dev/null &
child=$!
((heard)) && kill -TERM "$child" 2>/dev/null
code=127
while :; do
    # A signal ends the wait, not the run.
    heard=0
    wait "$child"
    now=$?
    ((now == 127)) || code=$now
    ((heard)) || break
done

if [[ $code -eq 75 || ($code -eq 143 && $warned -eq 1) ]]; then
    if ((restarts >= @RESTARTS@)); then
        fail "task $task is not done after $restarts restarts; submit the script again to resume" 75
    fi
    echo "$(date '+%F %T') task $task resumes after a restart"
    trap '' TERM
    scontrol requeue "$task" || fail "task $task could not be put into the queue again" 75
    exit 0
fi
@CHECK@exit "$code"
