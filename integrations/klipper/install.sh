#!/usr/bin/env bash
# Installs ffcomp on a printer's host: its own environment, the module that plays files of motion, Moonraker's component
# and its update block. May be run again at any time. See docs/HOST.md.
#
# Copyright (C) 2026  The ffcomp authors
# This file may be distributed under the terms of the GNU GPLv3 license.
set -euo pipefail

usage() {
    cat <<'TEXT'
install.sh [--machine NAME] [--only-module] [--uninstall] [--venv DIR] [--no-pip] [--no-warmup]
  --machine NAME  compensate every upload for this machine, through Moonraker
  --only-module   only what plays files of motion: prints are compensated elsewhere
  --uninstall     take everything away again; machine files stay
  --venv DIR      the environment (default: ~/ffcomp-env)
  --no-pip        use the environment as it is
  --no-warmup     do not compile now; the first print will
Variables: KLIPPER (default: ~/kalico or ~/klipper), MOONRAKER (~/moonraker), CONFIG (~/printer_data/config), PYTHON (python3)
TEXT
}

say() { printf 'ffcomp: %s\n' "$*"; }
fail() { printf 'ffcomp: %s\n' "$*" >&2; exit 1; }

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd -P)
root=$(cd "$here/../.." && pwd -P)
venv=$HOME/ffcomp-env machine='' uninstall='' pip=yes warmup=yes only=''
while [ $# -gt 0 ]; do
    case $1 in
        --machine) machine=${2:?--machine needs a name}; shift ;;
        --venv) venv=${2:?--venv needs a folder}; shift ;;
        --only-module) only=yes ;;
        --uninstall) uninstall=yes ;;
        --no-pip) pip='' ;;
        --no-warmup) warmup='' ;;
        -h | --help) usage; exit 0 ;;
        *) usage >&2; exit 2 ;;
    esac
    shift
done
[ "$(id -u)" -ne 0 ] || [ -n "${FFCOMP_AS_ROOT:-}" ] || fail 'run this as the user that runs Klipper, not as root.'

klipper=${KLIPPER:-$HOME/kalico}
[ -d "$klipper" ] || klipper=${KLIPPER:-$HOME/klipper}
moonraker=${MOONRAKER:-$HOME/moonraker}
config=${CONFIG:-$HOME/printer_data/config}
python=${PYTHON:-python3}

# Kalico has a folder for what is not its own; with Klipper it is one more of its extras.
modules=$klipper/klippy/extras
[ ! -d "$klipper/klippy/plugins" ] || modules=$klipper/klippy/plugins
component=$moonraker/moonraker/components/ffcomp.py
begin='# ffcomp: begin (written by its install.sh)' end='# ffcomp: end'

# Git shall not call the folder of another program changed: its updates would stop.
hide_from_git() { # folder of the repository, path in it
    local list=$1/.git/info/exclude
    [ -d "$1/.git/info" ] || return 0
    grep -qxF "/$2" "$list" 2>/dev/null || printf '/%s\n' "$2" >>"$list"
}

without_block() { # file: its text without ours, and without the empty lines before that
    awk -v begin="$begin" -v end="$end" '
        $0 == begin { inside = 1; blank = "" }
        !inside && /^$/ { blank = blank "\n"; next }
        !inside { printf "%s%s\n", blank, $0; blank = "" }
        $0 == end { inside = 0 }' "$1"
}

replace() { # file: takes the place of it at once; what is behind a link stays there
    local target draft
    target=$(readlink -f "$1")
    draft=$target.ffcomp-new
    cat >"$draft"
    if cmp -s "$draft" "$target"; then rm "$draft"; else
        [ ! -e "$target" ] || chmod --reference="$target" "$draft"
        mv "$draft" "$target"
    fi
}

update_block() {
    local origin=''
    origin=$(git -C "$root" config --get remote.origin.url 2>/dev/null || true)
    printf '\n%s\n' "$begin"
    if [ -n "$origin" ]; then
        printf '[update_manager ffcomp]\ntype: git_repo\npath: %s\norigin: %s\nprimary_branch: main\n' "$root" "$origin"
        printf 'managed_services: klipper\ninstall_script: integrations/klipper/install.sh\n'
    else
        printf '# no [update_manager ffcomp]: %s was not cloned by git\n' "$root"
    fi
    [ -z "$machine" ] || printf '\n[ffcomp]\nmachine: %s\n' "$machine"
    printf '%s\n' "$end"
}

known_machine() { # the one of an earlier run
    [ ! -f "$config/moonraker.conf" ] ||
        awk -v begin="$begin" -v end="$end" '$0 == begin { on = 1 } $0 == end { on = 0 }
            on && sub(/^machine: /, "") { print; exit }' "$config/moonraker.conf"
}

install_environment() {
    if [ -n "$pip" ]; then
        case $(uname -m) in
            arm | armv*) fail 'there are no ready-made packages for 32-bit ARM: use a 64-bit system, or --only-module.' ;;
        esac
        "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
            fail "$python is older than 3.11, which ffcomp needs (Raspberry Pi OS 12, bookworm, has it); PYTHON names another."
        [ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
        "$venv/bin/python" -m pip install --quiet --upgrade --prefer-binary "$root"
    fi
    [ -x "$venv/bin/ffcomp" ] || fail "$venv has no ffcomp."
    say "environment: $venv"
}

install_module() {
    if [ ! -d "$modules" ]; then
        say "no Klipper or Kalico at $klipper: KLIPPER names another place. The module is not installed."
        return
    fi
    ln -sfn "$here/ffcomp_print" "$modules/ffcomp_print"
    hide_from_git "$klipper" "${modules#"$klipper"/}/ffcomp_print"
    [ -d "$config" ] || { say "no $config: write [ffcomp_print] into printer.cfg yourself."; return; }
    [ -e "$config/ffcomp.cfg" ] || printf '# FFCOMP_PRINT FILE=…; written by install.sh\n[ffcomp_print]\n' >"$config/ffcomp.cfg"
    say "module: $modules/ffcomp_print"
    grep -qsE '^\[include ffcomp\.cfg\]' "$config/printer.cfg" ||
        say 'now write [include ffcomp.cfg] into printer.cfg, and restart Klipper.'
}

install_component() {
    if [ ! -d "$(dirname "$component")" ]; then
        say "no Moonraker at $moonraker: MOONRAKER names another place. Its component is not installed."
        return
    fi
    "$venv/bin/ffcomp" integrations install moonraker ${machine:+--machine "$machine"} --to "$(dirname "$component")" \
        >/dev/null 2>&1 || fail 'its component for Moonraker could not be written.'
    hide_from_git "$moonraker" moonraker/components/ffcomp.py
    say "component: $component"
    [ -f "$config/moonraker.conf" ] || { say "no $config/moonraker.conf: it has no update block."; return; }
    { without_block "$config/moonraker.conf"; update_block; } | replace "$config/moonraker.conf"
    say "block in $config/moonraker.conf; restart Moonraker."
}

remove_all() {
    [ ! -L "$modules/ffcomp_print" ] || rm "$modules/ffcomp_print"
    rm -f "$component"
    [ ! -f "$config/moonraker.conf" ] || without_block "$config/moonraker.conf" | replace "$config/moonraker.conf"
    [ ! -f "$config/ffcomp.cfg" ] || rm "$config/ffcomp.cfg"
    [ -z "$pip" ] || [ ! -f "$venv/pyvenv.cfg" ] || [ ! -e "$venv/bin/ffcomp" ] || rm -rf "$venv"
    say 'removed. Take [include ffcomp.cfg] out of printer.cfg, and restart Klipper and Moonraker.'
}

if [ -n "$uninstall" ]; then
    remove_all
    exit
fi
machine=${machine:-$(known_machine)}
if [ -n "$only" ]; then
    install_module
    exit
fi
install_environment
install_module
install_component
[ -z "$warmup" ] || { say 'compiling once, a few minutes on a Raspberry Pi …'; "$venv/bin/ffcomp" warmup; }
say 'done.'
