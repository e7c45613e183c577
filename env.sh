# Puts a bash shell into the built workspace: source env.sh
# (with ROS 2 Jazzy sourced first, where it is installed; else with the one in .venv)

_dyknow_root="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
if [ ! -f "$_dyknow_root/.venv/set-up-for" ]; then
  echo "env.sh: nothing is set up yet; run: make build" >&2
  unset _dyknow_root
  return 1 2>/dev/null || exit 1
fi
. "$_dyknow_root/.venv/bin/activate"
if ! grep -q '^ros ' "$_dyknow_root/.venv/set-up-for"; then
  # Without an installed ROS the virtual environment is the ROS prefix.
  export AMENT_PREFIX_PATH="$VIRTUAL_ENV" CMAKE_PREFIX_PATH="$VIRTUAL_ENV"
  unset COLCON_PREFIX_PATH PYTHONPATH
fi
if [ -f "$_dyknow_root/install/local_setup.bash" ]; then
  . "$_dyknow_root/install/local_setup.bash"
fi
unset _dyknow_root
if [[ $- == *i* ]] && command -v register-python-argcomplete > /dev/null; then
  eval "$(register-python-argcomplete dyknow)"
fi
