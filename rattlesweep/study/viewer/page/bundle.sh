#!/bin/sh
# Make three.min.js; run it after a change of version or of the entry.
set -eu
three=0.187.0 esbuild=0.28.2
here=$(cd "$(dirname "$0")" && pwd)
room=$(mktemp -d)
trap 'rm -rf "$room"' EXIT
cp "$here/three.entry.js" "$room/"
cd "$room"
npm install --silent --no-save "three@$three" "esbuild@$esbuild"
# Every page that holds the bundle holds the licence too.
npx esbuild three.entry.js --bundle --minify --format=iife --global-name=THREE --charset=ascii \
  --legal-comments=none --banner:js="/*! three.js $three
$(cat node_modules/three/LICENSE)
*/" --outfile="$here/three.min.js"
