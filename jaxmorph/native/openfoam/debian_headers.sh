#!/usr/bin/env bash
# Debian's packages of OpenFOAM have no headers. This fetches those of the installed version from its source package, so
# that wmake compiles for it: debian_headers.sh FOLDER && . FOLDER/etc/bashrc
# It needs apt, bzip2, make and g++, and no rights.
set -euo pipefail
mkdir -p "$1"
cd "$1"
mkdir -p apt/sources apt/lists/partial apt/cache/archives/partial
for list in /etc/apt/sources.list /etc/apt/sources.list.d/debian.sources; do
  [ -e "$list" ] || continue
  sed -E 's/^deb /deb-src /; s/^Types: .*/Types: deb-src/' "$list" >"apt/sources/$(basename "$list")"
done
apt=(apt-get -qq -o Dir::Etc::sourcelist=/dev/null -o "Dir::Etc::sourceparts=$PWD/apt/sources")
apt+=(-o APT::Sandbox::User=root -o "Dir::State::lists=$PWD/apt/lists" -o "Dir::Cache=$PWD/apt/cache")
"${apt[@]}" update
"${apt[@]}" source --download-only "openfoam=$(dpkg-query -W -f '${source:Version}' openfoam)"
parts=(etc bin wmake META-INFO src/OpenFOAM src/OSspecific src/finiteVolume src/meshTools src/dynamicMesh)
tar -xf openfoam_*.orig.tar.* --strip-components=1 --wildcards "${parts[@]/#/*/}"
bash -c '
  . etc/bashrc
  make -C "$WM_DIR/src"
  for name in OpenFOAM OSspecific/POSIX finiteVolume meshTools dynamicMesh; do wmakeLnInclude -u "src/$name"; done
' >/dev/null
rm -r apt openfoam_*
