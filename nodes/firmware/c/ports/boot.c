/* The bootloader: starts the newest whole program, or the one before if the newest was started once and never reached over the bus. */
#include "port.h"

int main(void)
{
    port_start(skin_program_choose(&port_programs));
    return 0;
}
