/* The GNC of gnc.c (or any other with the functions of hil_gnc.h) as a separate program, over UDP.
 *
 *     cc -O2 -I"$(hil gnc header --folder)" gnc_udp.c gnc.c -o gnc_udp -lm
 *     hil dss scheme-1 --lock-step &          # on the computer of the bench
 *     ./gnc_udp 127.0.0.1 24500               # on this one: address and port of hil dss
 *
 * The datagrams are those of docs/reference/wire-formats.md: a header of 32 bytes, a struct of hil_gnc.h and a tag by the
 * key of the link. This program sends hello until the bench replies, then replies to each setup, which
 * comes in two datagrams, and each input with one output.
 */
#define _POSIX_C_SOURCE 200809L
#include <netdb.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include "hil_gnc.h"
#include "link_tag.h"

enum { VERSION = 2, HEADER = 32, LARGEST = 1472, SILENT = 10 /* time-outs of 0.1 s, then hello is sent again */ };
enum { HELLO = 1, CELL = 2, GOODBYE = 4, REFUSED = 5 };
enum { SETUP = 1, INPUT = 2, OUTPUT = 3, ORBIT = 24 };
enum { /* hil_gnc_setup comes in two datagrams: its first bytes, and those of orbit and motion of the target */
    FIRST = offsetof(hil_gnc_setup, eccentricity),
    REST = sizeof(hil_gnc_setup) - FIRST,
    /* hil_gnc_input without `measured`, whose parts are mailboxes that this program does not ask for */
    HEAD = offsetof(hil_gnc_input, measured)
};
enum { ROLE_GNC = 2, OFFERS = 1, WANTS = 2 };

typedef struct { /* layout of the datagram's header, without gaps */
    char magic[4];
    uint32_t crc;
    uint8_t version, kind;
    uint16_t cell, size, layout;
    uint32_t writer, sequence;
    double time_s;
} header;

typedef struct {
    int32_t role, count;
    char name[32];
    struct {
        uint16_t number, bytes, layout, use;
    } cells[16];
} hello;

static int wire;        /* the socket */
static uint32_t writer; /* identifies this start of the program */
static uint32_t bench;  /* writer number of the bench, from its datagrams */
static const char *key; /* of the link */

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* The CRC-32 of zlib, PNG and Ethernet. */
static uint32_t crc32(const uint8_t *bytes, size_t count)
{
    uint32_t crc = 0xFFFFFFFFu;
    while (count--) {
        crc ^= *bytes++;
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static void send_datagram(int kind, int cell, const void *payload, size_t size)
{
    static uint32_t counts[8];
    uint8_t datagram[LARGEST + TAG];
    header h = {{'F', 'R', 'M', 'N'}, 0, VERSION, (uint8_t)kind, (uint16_t)cell, (uint16_t)size, 0, writer, 0, 0.0};
    h.sequence = ++counts[kind];
    h.time_s = now_s();
    memcpy(datagram, &h, HEADER);
    memcpy(datagram + HEADER, payload, size);
    h.crc = crc32(datagram + 8, HEADER - 8 + size);
    memcpy(datagram, &h, HEADER);
    link_tag(key, kind == HELLO ? 0 : bench, datagram, HEADER + size, datagram + HEADER + size);
    if (send(wire, datagram, HEADER + size + TAG, 0) < 0)
        return; /* the bench is not listening yet: hello is sent again */
}

static void send_hello(void)
{
    hello h = {ROLE_GNC, 4, "gnc_udp", {{OUTPUT, sizeof(hil_gnc_output), 0, OFFERS},
                                        {SETUP, FIRST, 0, WANTS},
                                        {ORBIT, REST, 0, WANTS},
                                        {INPUT, HEAD, 0, WANTS}}};
    send_datagram(HELLO, 0, &h, sizeof h);
}

/* Wait up to 0.1 s for a valid datagram; return the size of its payload, -1 without one. */
static long receive(header *h, uint8_t payload[LARGEST])
{
    uint8_t datagram[LARGEST + TAG + 1], tag[TAG];
    const ssize_t got = recv(wire, datagram, sizeof datagram, 0) - TAG;
    if (got < HEADER || got > LARGEST)
        return -1;
    memcpy(h, datagram, HEADER);
    const int begins = h->kind == REFUSED || (h->kind == CELL && h->cell == SETUP);
    link_tag(key, begins ? 0 : writer, datagram, (size_t)got, tag);
    if (memcmp(tag, datagram + got, TAG) != 0)
        return -1;
    if (memcmp(h->magic, "FRMN", 4) != 0 || h->version != VERSION || h->size != got - HEADER
        || h->crc != crc32(datagram + 8, (size_t)got - 8))
        return -1;
    bench = h->writer;
    memcpy(payload, datagram + HEADER, h->size);
    return h->size;
}

static int open_wire(const char *host, const char *port)
{
    const struct addrinfo wanted = {.ai_family = AF_UNSPEC, .ai_socktype = SOCK_DGRAM};
    const struct timeval patience = {.tv_usec = 100000};
    struct addrinfo *found;
    if (getaddrinfo(host, port, &wanted, &found) != 0)
        return -1;
    wire = socket(found->ai_family, SOCK_DGRAM, 0);
    const int failed = wire < 0 || connect(wire, found->ai_addr, found->ai_addrlen) != 0
        || setsockopt(wire, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience) != 0;
    freeaddrinfo(found);
    return failed ? -1 : 0;
}

int main(int argc, char **argv)
{
    static uint8_t payload[LARGEST];
    header h;
    void *gnc = NULL;
    int64_t cycle = -1;
    int32_t mode = -1;
    int silent = 0, begun = 0;
    hil_gnc_setup setup;
    hil_gnc_output output;
    char reason[HIL_GNC_REASON_BYTES] = "";

    if (argc != 3 || open_wire(argv[1], argv[2]) != 0) {
        fprintf(stderr, "usage: %s HOST PORT, those of hil dss\n", argv[0]);
        return 2;
    }
    key = link_key();
    writer = (uint32_t)(now_s() * 1000.0) ^ ((uint32_t)getpid() << 16);
    for (;;) {
        const long size = receive(&h, payload);
        if (size < 0) {
            if (gnc == NULL || ++silent > SILENT)
                send_hello();
            continue;
        }
        silent = 0;
        if (h.kind == REFUSED || h.kind == GOODBYE) {
            if (h.kind == REFUSED)
                fprintf(stderr, "refused by the bench: %.124s\n", (const char *)payload + 4);
            hil_gnc_close(gnc);
            return h.kind == REFUSED ? 2 : 0;
        }
        if (h.kind != CELL)
            continue;
        if (h.cell == SETUP && size == FIRST) {
            memcpy(&setup, payload, FIRST);
            begun = 1;
            continue; /* the rest follows */
        }
        if (h.cell == ORBIT && size == REST && begun) {
            memcpy((char *)&setup + FIRST, payload, REST);
            begun = 0;
            hil_gnc_close(gnc);
            gnc = hil_gnc_open(&setup, reason);
            if (gnc == NULL) {
                fprintf(stderr, "the GNC refuses: %s\n", reason);
                return 2;
            }
            cycle = -1, mode = -1;
            memset(&output, 0, sizeof output);
            output.cycle = -1;
            output.state = HIL_GNC_WORKING;
        } else if (h.cell == INPUT && size == HEAD && gnc != NULL) {
            static hil_gnc_input input;
            memcpy(&input, payload, HEAD);
            if (input.cycle != cycle || input.mode != mode) { /* otherwise the reply was lost: send it again */
                memset(&output, 0, sizeof output);
                output.cycle = input.cycle;
                output.state = HIL_GNC_WORKING;
                if (hil_gnc_step(gnc, &input, &output) != 0)
                    output.state = HIL_GNC_FAULT;
                cycle = input.cycle, mode = input.mode;
            }
        } else {
            continue;
        }
        send_datagram(CELL, OUTPUT, &output, sizeof output);
    }
}
