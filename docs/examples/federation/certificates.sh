#!/bin/sh
# Makes a certificate authority, and a certificate for each name: certificates.sh FOLDER NAME...
set -e
cd "$1"
shift
new="-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes"
openssl req -x509 $new -keyout ca.key -out ca.pem -subj "/CN=fleet" -days 365 \
  -addext "basicConstraints=critical,CA:TRUE"
for name in "$@"; do
  openssl req $new -keyout "$name.key" -out "$name.csr" -subj "/CN=$name"
  # By these names and addresses others connect to the host.
  echo "subjectAltName=DNS:$name,DNS:localhost,IP:127.0.0.1" > "$name.ext"
  openssl x509 -req -in "$name.csr" -CA ca.pem -CAkey ca.key -CAcreateserial -out "$name.pem" \
    -days 365 -extfile "$name.ext"
  rm "$name.csr" "$name.ext"
done
