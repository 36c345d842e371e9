#!/bin/sh
# Open3D needs five system libraries that pip cannot install. Root on Debian or Ubuntu gets
# them installed; everybody else gets the command.
missing=
for pair in libusb-1.0.so.0:libusb-1.0-0 libGL.so.1:libgl1 libEGL.so.1:libegl1 libgomp.so.1:libgomp1 libX11.so.6:libx11-6
do
    library=${pair%%:*}
    package=${pair##*:}
    ldconfig -p 2>/dev/null | grep -q "$library" ||
        /sbin/ldconfig -p 2>/dev/null | grep -q "$library" || missing="$missing $package"
done
[ -z "$missing" ] && exit 0
[ "$(uname -s)" = Linux ] || exit 0  # elsewhere Open3D's wheels bring what they need
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing system libraries:$missing"
    apt-get update -qq && apt-get install -y -qq --no-install-recommends $missing && exit 0
fi
echo "missing system libraries; install them with: sudo apt-get install$missing" >&2
exit 2
