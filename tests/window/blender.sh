#!/usr/bin/env bash
# A Blender with a window, as users have it, on a screen that nobody sees. For walk.py, and for hands.
#
#   blender.sh install ROOT             Debian's unstable release with Blender, Xvfb and Mesa into ROOT: as root, 2 GB
#   blender.sh run ROOT HOME ARGUMENT…  that Blender, 1600x1000 pixels; its configuration lies in HOME
#   blender.sh do ROOT COMMAND…         a command beside it, as `xdotool key 96` or `import -window root shot.png`
#   blender.sh stop ROOT                end the screen, and unmount what ROOT shows of the machine: before ROOT is deleted
#
# The folder for temporary files is seen inside at the same place as outside. Debian's Blender is newer than the
# project's own, so that both are tried. The screen has no graphics card: Mesa draws.
set -euo pipefail

usage() {
    sed -n '2,10s/^# \?//p' "$0" >&2
    exit 2
}
[ $# -ge 2 ] || usage
verb=$1 root=$2
shift 2
shared=${TMPDIR:-/tmp}
display=:88

packages=(blender xvfb xdotool x11-utils imagemagick openbox fonts-dejavu-core xauth libgl1-mesa-dri
    python3-numpy python3-requests python3-cattr python3-zstandard) # the last two: Blender's extension manager

within() {
    nice -n 15 chroot "$root" env HOME="${home:-/root}" DISPLAY=$display LIBGL_ALWAYS_SOFTWARE=1 LC_ALL=C.UTF-8 "$@"
}

mounted() {
    local place
    for place in proc sys dev; do
        mountpoint -q "$root/$place" || mount --rbind --make-rslave "/$place" "$root/$place"
    done
    mkdir -p "$root$shared"
    mountpoint -q "$root$shared" || mount --bind "$shared" "$root$shared"
}

is_up() { within xdpyinfo > /dev/null 2>&1; }

screen() {
    is_up && return
    rm -f "$root/tmp/.X${display#:}-lock"
    # Not `within`: the number is to be the screen's own.
    nice -n 15 chroot "$root" Xvfb "$display" -screen 0 1600x1000x24 -nolisten tcp > /dev/null 2>&1 &
    echo $! > "$root/screen.pid"
    for _ in $(seq 100); do
        is_up && break
        sleep 0.1
    done
    within openbox > /dev/null 2>&1 &
}

case $verb in
install)
    command -v debootstrap > /dev/null || {
        apt-get update -q
        apt-get install -qy debootstrap
    }
    mirror=$(sed -n 's/^URIs: *\(.*\/debian\)\/*$/\1/p' /etc/apt/sources.list.d/*.sources 2> /dev/null | head -1)
    [ -e "$root/etc/debian_version" ] || debootstrap --variant=minbase sid "$root" "${mirror:-http://deb.debian.org/debian}"
    cp /etc/resolv.conf "$root/etc/resolv.conf"
    mounted
    within apt-get -o Acquire::Check-Valid-Until=false update -q
    within env DEBIAN_FRONTEND=noninteractive apt-get install -qy --no-install-recommends "${packages[@]}"
    within blender --version | head -1
    ;;
run)
    home=${1:?a folder for the configuration}
    shift
    mkdir -p "$home"
    mounted
    screen
    within blender --gpu-backend opengl --window-geometry 0 0 1600 1000 "$@"
    ;;
do)
    mounted
    within "$@"
    ;;
stop)
    [ ! -e "$root/screen.pid" ] || kill "$(cat "$root/screen.pid")"
    rm -f "$root/screen.pid"
    for place in "$root$shared" "$root/dev" "$root/sys" "$root/proc"; do
        # Private first: what is unmounted here stays mounted outside.
        mountpoint -q "$place" && mount --make-rprivate "$place" && umount -R -l "$place" || true
    done
    ;;
*) usage ;;
esac
