/* Never sleeps. */
#include "uart.h"

int main(void)
{
	uart_begin();
	for (;;)
		if (UCSR0A & 1 << RXC0)
			uart_send(UDR0);
}
