#!/bin/bash
# Boots Debian's PREEMPT_RT kernel in QEMU and runs the product in it: privileges, preflight, CiA 402 over vcan, vivid.
#
#   sims/rt_guest.sh [WORK_FOLDER]        (default /tmp/hil-rt-guest)
#
# Needs root, apt-get install qemu-system-x86 busybox-static cpio kmod, and python3 with the product's packages as PYTHON.
# The root of this computer is the guest's, read-only over 9p; what it writes is in its memory. Function is tested, not
# timing. The processor is emulated, which takes minutes for each start of Python; ACCELERATOR=kvm on a computer whose
# /dev/kvm boots a guest. Output: guest.log.
set -e
work=${1:-/tmp/hil-rt-guest}
top=$(cd "$(dirname "$0")/.." && pwd)
python=${PYTHON:-$(command -v python3)}
mkdir -p "$work/initrd/bin" "$work/initrd/modules"
cd "$work"
if ! ls linux-image-*.deb >/dev/null 2>&1; then
    apt-get download "$(apt-cache depends linux-image-rt-amd64 | awk '/Depends:/{print $2; exit}')"
fi
[ -d image ] || dpkg -x linux-image-*.deb image
release=$(ls image/lib/modules)
cp "$(command -v busybox)" initrd/bin/busybox

# modules in the order of their dependencies
wanted="virtio_pci 9pnet_virtio 9p overlay can_raw vcan vivid"
depmod -b image "$release"
: > initrd/modules/order
for module in $wanted; do
    modprobe -d image -S "$release" --show-depends "$module" | awk '$1 == "insmod" {print $2}' | while read -r file; do
        name=$(basename "$file")
        grep -qx "$name" initrd/modules/order && continue
        cp "$file" "initrd/modules/$name"
        echo "$name" >> initrd/modules/order
    done
done

cat > initrd/init <<'INIT'
#!/bin/busybox sh
/bin/busybox mkdir -p /proc /sys /dev /host /writes /root
/bin/busybox mount -t proc none /proc
while read -r module; do /bin/busybox insmod /modules/$module || echo "insmod $module failed"; done < /modules/order
/bin/busybox mount -t 9p -o trans=virtio,version=9p2000.L,ro,msize=262144 host /host || /bin/busybox poweroff -f
/bin/busybox mount -t tmpfs none /writes
/bin/busybox mkdir -p /writes/upper /writes/work
/bin/busybox mount -t overlay -o lowerdir=/host,upperdir=/writes/upper,workdir=/writes/work none /root
for place in proc sys dev; do /bin/busybox mkdir -p /root/$place; done
/bin/busybox mount -t proc none /root/proc
/bin/busybox mount -t sysfs none /root/sys
/bin/busybox mount -t devtmpfs none /root/dev
/bin/busybox mkdir -p /root/dev/pts /root/dev/shm
/bin/busybox mount -t devpts none /root/dev/pts
/bin/busybox mount -t tmpfs none /root/dev/shm
/bin/busybox ip link set lo up
/bin/busybox ip link add dev vcan0 type vcan
/bin/busybox ip link set vcan0 up
/bin/busybox chroot /root /bin/bash -c "$(/bin/busybox sed 's/.*hil_run=\([^ ]*\).*/\1/' /proc/cmdline)"
echo "rt_guest: end"
/bin/busybox poweroff -f
INIT
chmod +x initrd/init
(cd initrd && find . | cpio -o -H newc --quiet | gzip -1) > initrd.gz
cat > run.sh <<RUN
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root HIL_CACHE_DIR=${HIL_CACHE_DIR:-/tmp/kernels} PYTHONPATH=$top
cd $top
exec timeout ${GUEST_S:-900} $python sims/rt_guest.py
RUN
chmod +x run.sh
accelerator=${ACCELERATOR:-tcg}

nice -n 15 timeout "${QEMU_S:-1200}" qemu-system-x86_64 -machine q35,accel=$accelerator -cpu max,arch-capabilities=off -smp 2 -m 3072 \
    -nographic -no-reboot -kernel "image/boot/vmlinuz-$release" -initrd initrd.gz \
    -virtfs local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap \
    -append "console=ttyS0 edd=off loglevel=4 panic=-1 hil_run=$work/run.sh" < /dev/null 2>&1 | tee guest.log
grep -q "rt_guest: passed" guest.log
