@ Reset and exceptions of an ARMv7-A processor: stacks, no unaligned access, floating point, memory; then main.
    .syntax unified
    .arch armv7-a
    .fpu vfpv4-d16
    .section .start, "ax"
    .arm
    .global _start
_start:
    ldr pc, =reset
    ldr pc, =undefined
    ldr pc, =undefined
    ldr pc, =prefetch
    ldr pc, =data
    nop
    ldr pc, =interrupt
    ldr pc, =undefined
    .ltorg
reset:
    cpsid if, #0x12             @ mode IRQ
    ldr sp, =__interrupt_stack
    cps #0x13                   @ mode SVC
    ldr sp, =__stack
    ldr r0, =_start             @ VBAR
    mcr p15, 0, r0, c12, c0, 0
    mrc p15, 0, r0, c1, c0, 0   @ SCTLR: A, an unaligned access is a fault; not V, vectors where VBAR says
    orr r0, r0, #2
    bic r0, r0, #0x2000
    mcr p15, 0, r0, c1, c0, 0
    mrc p15, 0, r0, c1, c0, 2   @ CPACR: floating point is there
    orr r0, r0, #0xF00000
    mcr p15, 0, r0, c1, c0, 2
    mov r0, #0
    mcr p15, 0, r0, c7, c5, 0   @ ICIALLU: the bootloader has written the program
    dsb
    isb
    mov r0, #0x40000000
    vmsr fpexc, r0
    ldr r0, =__bss_start
    ldr r1, =__bss_end
    mov r2, #0
1:  cmp r0, r1
    strlo r2, [r0], #4
    blo 1b
    ldr r0, =__stack_bottom     @ what stays painted was never used
    ldr r1, =__interrupt_stack
    ldr r2, =0xA5A5A5A5
2:  cmp r0, r1
    strlo r2, [r0], #4
    blo 2b
    bl main
    b .
interrupt:                      @ saves what a C function may use, reals as well
    sub lr, lr, #4
    push {r0-r3, r12, lr}
    vpush {d0-d7}
    vmrs r0, fpscr
    push {r0, r1}
    bl virt_interrupt
    pop {r0, r1}
    vmsr fpscr, r0
    vpop {d0-d7}
    ldm sp!, {r0-r3, r12, pc}^
undefined:
    mov r0, #1
    b fault
prefetch:
    mov r0, #2
    b fault
data:
    mov r0, #3
fault:
    mov r1, lr
    ldr sp, =__stack
    bl virt_fault
    b .
