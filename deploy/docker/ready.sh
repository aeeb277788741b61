#!/usr/bin/env bash
# Health check of a container: is this process ready? Answers 0 if so, 1 if not. No curl in the image: bash speaks enough HTTP.
address="${CROSS_READY_ADDRESS:-127.0.0.1}"
port="${CROSS_READY_PORT:-7401}"
exec 3<>"/dev/tcp/$address/$port" || exit 1
printf 'GET /ready HTTP/1.0\r\nHost: %s\r\n\r\n' "$address" >&3
read -r -t 2 _ status _ <&3
[ "$status" = 200 ]
