#!/bin/sh
# Make three.min.js, in this folder or the one named, and record its checksum; run it after a change
# of the entry or of a version, which package.json says and package-lock.json pins:
#   npm install --package-lock-only --omit-lockfile-registry-resolved
set -eu
here=$(cd "$(dirname "$0")" && pwd)
there=$(cd "${1:-$here}" && pwd)
room=$(mktemp -d)
trap 'rm -rf "$room"' EXIT
cp "$here/three.entry.js" "$here/package.json" "$here/package-lock.json" "$room/"
cd "$room"
npm ci --silent
version=$(node -p 'require("./package.json").devDependencies.three')
# Every page that holds the bundle holds the licence too.
npx esbuild three.entry.js --bundle --minify --format=iife --global-name=THREE --charset=ascii \
  --legal-comments=none --banner:js="/*! three.js $version
$(cat node_modules/three/LICENSE)
*/" --outfile="$there/three.min.js"
cd "$there"
sha256sum three.min.js >three.min.js.sha256
